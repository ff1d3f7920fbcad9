// Driving by hand: the stick and the arrow keys. The robot drives only while one of them is held.

import { effect } from "./vendor/preact.js";
import { connection, stop } from "./commands.js";
import * as store from "./store.js";

const PERIOD = 50; // milliseconds between two velocities
const DEAD_ZONE = 0.12; // of the stick's radius
const KEYS = /** @type {Record<string, [number, number]>} */ ({
  ArrowUp: [1, 0],
  ArrowDown: [-1, 0],
  ArrowLeft: [0, 1],
  ArrowRight: [0, -1],
});

let press = 0; // number of the current or last press
let timer = 0;
const pressed = /** @type {Set<string>} */ (new Set()); // arrow keys that are down

/**
 * Return the velocity for the distance of a pointer from where it went down.
 * @param {number} right of the stick's radius
 * @param {number} up of the stick's radius
 */
export function stickVelocity(right, up) {
  const { linear, angular } = store.control.value?.limits ?? { linear: 0, angular: 0 };
  const dead = (/** @type {number} */ value) => (Math.abs(value) < DEAD_ZONE ? 0 : value);
  return {
    linear: dead(up) * linear,
    // backwards, the robot still moves to the side to which the stick points
    angular: -dead(right) * angular * (up < -DEAD_ZONE ? -1 : 1),
  };
}

/** Hold a velocity; begin a press if nothing is held. @param {{linear: number, angular: number}} velocity */
export function hold(velocity) {
  if (!store.held.value) store.answer.value = null; // answer to an earlier press or command
  store.held.value = velocity;
}

/** End the press: a pointer that is still down does not drive until it is pressed anew. */
export function letGo() {
  store.held.value = null;
}

effect(() => {
  const holds = store.held.value !== null;
  if (holds && !timer) {
    press++;
    sendVelocity();
    timer = setInterval(sendVelocity, PERIOD);
  } else if (!holds && timer) {
    clearInterval(timer);
    timer = 0;
    sendVelocity();
  }
});

function sendVelocity() {
  const { linear, angular } = store.held.peek() ?? { linear: 0, angular: 0 };
  connection.send({ do: "drive", linear, angular, press, clock: connection.clock });
}

/** @param {EventTarget | null} target */
function takesKeys(target) {
  return target instanceof HTMLElement && target.matches("input, select, textarea, [role=tab]");
}

/** @param {KeyboardEvent} event */
function keyDown(event) {
  if (event.key === "Escape" && store.mayControl.value) {
    if (!event.repeat) stop();
    return;
  }
  if (!store.keyboard.value || !(event.key in KEYS) || takesKeys(event.target)) return;
  event.preventDefault();
  event.stopPropagation();
  if (event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
  pressed.add(event.key);
  driveByKeys();
}

/** @param {KeyboardEvent} event */
function keyUp(event) {
  if (!pressed.delete(event.key)) return;
  if (pressed.size) driveByKeys();
  else letGo();
}

function driveByKeys() {
  const ways = [...pressed].map((key) => KEYS[key]);
  const up = ways.reduce((sum, [each]) => sum + each, 0);
  const left = ways.reduce((sum, [, each]) => sum + each, 0);
  hold(stickVelocity(-left, up));
}

function leave() {
  pressed.clear();
  letGo();
}

addEventListener("keydown", keyDown, { capture: true });
addEventListener("keyup", keyUp, { capture: true });
document.addEventListener("visibilitychange", () => document.hidden && leave());
addEventListener("blur", leave);
addEventListener("pagehide", leave);
effect(() => {
  if (!store.keyboard.value || !store.held.value) pressed.clear();
});
