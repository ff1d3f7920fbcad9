// Driving by hand: the velocities, the arrow keys, and the events that end a press of the stick or of a key.

import { effect } from "./vendor/preact.js";
import { connection, stop, tell } from "./commands.js";
import * as store from "./store.js";
import { remember, remembered } from "./texts.js";

const PERIOD = 50; // milliseconds between two velocities
const STORAGE_KEY = "woosh.slow"; // in the storage of the browser

let press = 0; // number of the current or last press
let timer = 0; // of the velocities; 0 while nothing is held
store.slow.value = remembered(STORAGE_KEY) === "true";

/** Drive slowly, or no longer. Only the next press does so: a held stick gets no faster. */
export function toggleSlow() {
  store.letGo();
  store.slow.value = !store.slow.value;
  remember(STORAGE_KEY, String(store.slow.value));
}

effect(() => {
  const isHeld = store.held.value !== null;
  if (isHeld && !timer) {
    press++;
    store.answer.value = null; // answer to an earlier press or command
    sendVelocity();
    timer = setInterval(repeatVelocity, PERIOD);
  } else if (!isHeld && timer) {
    clearInterval(timer);
    timer = 0;
    sendVelocity(); // zero
  }
});

function repeatVelocity() {
  checkStickPlace();
  if (store.held.peek()) sendVelocity();
}

function sendVelocity() {
  const { linear, angular } = store.held.peek() ?? { linear: 0, angular: 0 };
  connection.send({ do: "drive", linear, angular, press, clock: connection.clock });
}

/** Return true if an element uses the arrow keys itself. @param {EventTarget | null} target */
function takesKeys(target) {
  return target instanceof HTMLElement && target.matches("input, select, textarea, [role=tab]");
}

/** @param {KeyboardEvent} event */
function keyDown(event) {
  if (event.repeat && event.key === "Enter") event.preventDefault(); // it presses a button once
  const composing = event.isComposing; // Esc then belongs to the input method
  if (event.key === "Escape" && !composing && (store.mayControl.value || store.lostControl.value)) {
    if (!event.repeat) stop(); // without control, the refusal raises the alarm
    return;
  }
  if (!(event.code in store.KEY_DIRECTIONS)) {
    store.letGo(); // the key may open a menu or begin a shortcut, which takes the key-up
    return;
  }
  if (!store.keyboard.value || takesKeys(event.target)) return;
  event.preventDefault();
  event.stopPropagation();
  if (event.repeat || event.ctrlKey || event.altKey || event.metaKey || store.grip.value) return;
  store.heldKeys.value = new Set(store.heldKeys.value).add(event.code);
}

/** @param {KeyboardEvent} event */
function keyUp(event) {
  const keys = new Set(store.heldKeys.value);
  if (keys.delete(event.code)) store.heldKeys.value = keys;
}

/** @param {PointerEvent} event */
function pointerDown({ target }) {
  if (!(target instanceof Element && target.closest("#stick"))) store.letGo();
}

/** Return all that tells where the stick is on the screen, as a text to compare. @returns {string} */
export function stickPlace() {
  const { left, top, width } = /** @type {HTMLElement} */ (
    document.getElementById("stick")
  ).getBoundingClientRect();
  const { scale, offsetLeft, offsetTop } = /** @type {VisualViewport} */ (visualViewport);
  const view = [innerWidth, innerHeight, devicePixelRatio, scale, offsetLeft, offsetTop];
  return [left, top, width, ...view, screen.orientation?.angle].join(" ");
}

/** End the press of the stick if the stick has got another place on the screen since it began. */
export function checkStickPlace() {
  const grip = store.grip.peek();
  if (!grip || grip.place === stickPlace()) return;
  store.letGo();
  tell(false, { key: "reason.screenChanged", values: {} });
}

/** Switch the arrow keys off, because the viewer can no longer see that they drive. */
export function keysOff() {
  if (!store.keyboard.value) return;
  store.keyboard.value = false;
  tell(true, { key: "keyboard.off", values: {} });
}

// Whatever may hide the end of a press from the page ends it.
addEventListener("keydown", keyDown, { capture: true });
addEventListener("keyup", keyUp, { capture: true });
addEventListener("pointerdown", pointerDown, { capture: true });
addEventListener("focusin", store.letGo);
addEventListener("blur", store.letGo);
addEventListener("pagehide", store.letGo);
document.addEventListener("visibilitychange", () => {
  if (!document.hidden) return;
  store.letGo();
  keysOff();
});
effect(() => {
  // also what is pressed while nothing can be sent: it would drive once that is possible again
  if (store.outdated.value && store.held.value) store.letGo();
});
effect(() => {
  if (!store.keyboard.value) store.letGo();
});
