// Buttons and stick that command the robot.

const PERIOD = 100; // milliseconds between two velocities while the stick is held
const DEAD_ZONE = 0.12; // share of the stick's radius
const DOUBLE_CLICK = 500; // milliseconds within which the same command is given once

export class Controls {
  /**
   * @param {import("./connection.js").Connection} connection
   * @param {(ok: boolean, text: string, robot?: number) => void} show shows the answer to a command,
   *   and for which robot it was
   * @param {(text: string, robot: number) => void} alarm shows why a stop of a robot has failed;
   *   without a text, it ends the alarm
   */
  constructor(connection, show, alarm) {
    this.connection = connection;
    this.show = show;
    this.alarm = alarm;
    this.limits = {linear: 0, angular: 0};
    this.stick = document.querySelector("#stick");
    this.knob = document.querySelector("#knob");
    this.turn = document.querySelector("#turn");
    this.velocity = null; // {linear, angular} while the stick or the slider is held
    this.press = 0; // number of the current or last press
    this.pointer = null; // id of the pointer that holds the stick
    this.centre = {x: 0, y: 0}; // where it went down, in pixels
    this.stopPointer = null; // id of the pointer that went down on STOP
    this.given = new Map(); // when each command was last given, and if its answer is pending
    this.enabled = false;
    this.modes = []; // numbers of control and work mode as the lists have followed them
    this.bind();
  }

  enable() {
    this.enabled = true;
    for (const each of document.querySelectorAll(".control, #stop, #stick")) each.hidden = false;
    document.querySelector("#tools").hidden = false;
  }

  /** Let the lists follow the modes of the robot; a choice stays until the robot's mode changes. */
  showModes(modes) {
    ["#control-mode", "#work-mode"].forEach((selector, index) => {
      if (modes[index] === this.modes[index]) return;
      document.querySelector(selector).value = String(modes[index]); // an unknown one: no choice
    });
    this.modes = modes;
  }

  /** Give a command. A double click, or a click while the answer is pending, gives no other one. */
  async run(name, args = {}) {
    const {robot} = this.connection, now = performance.now();
    const task = name === "go" || name === "goMark"; // one click, one task, wherever it was
    const key = JSON.stringify(task ? [robot] : [robot, name, args]);
    const {since, pending} = this.given.get(key) ?? {since: -Infinity, pending: false};
    if (now < since + DOUBLE_CLICK) return;
    if (pending) {
      this.show(false, `${name} was not sent: the robot has not answered the former one`, robot);
      return;
    }
    this.given.set(key, {since: now, pending: true});
    const {ok, text} = await this.connection.command(name, args);
    this.given.set(key, {since: now, pending: false});
    this.show(ok, text, robot);
  }

  async stop() {
    this.letGo();
    const {robot} = this.connection;
    this.show(true, "stopping", robot);
    const {ok, text} = await this.connection.stop();
    this.show(ok, text, robot);
    this.alarm(ok ? "" : `Press the emergency stop: STOP is not confirmed (${text})`, robot);
  }

  bind() {
    const on = (selector, event, call) =>
      document.querySelector(selector).addEventListener(event, call);
    // at once, and also while another finger holds the stick: that makes no click
    on("#stop", "pointerdown", ({pointerId}) => {
      this.stopPointer = pointerId;
      this.stop();
    });
    on("#stop", "click", ({pointerId}) => { // of the keyboard or of an assistive technology
      if (pointerId !== this.stopPointer) this.stop();
      this.stopPointer = null;
    });
    on("#release", "click", () => this.connection.send({do: "release"}));
    for (const button of document.querySelectorAll("[data-command]")) {
      button.addEventListener("click", () => this.run(button.dataset.command));
    }
    on("#set-control-mode", "click", () =>
      this.run("controlMode", {mode: Number(document.querySelector("#control-mode").value)}));
    on("#set-work-mode", "click", () =>
      this.run("workMode", {mode: Number(document.querySelector("#work-mode").value)}));
    on("#speak", "submit", (event) => {
      event.preventDefault();
      this.run("speak", {text: document.querySelector("#speak-text").value});
      document.activeElement.blur(); // the space bar stops again
    });
    addEventListener("keydown", (event) => {
      if (event.code !== "Space" || !this.enabled || isText(event.target)) return;
      event.preventDefault();
      if (!event.repeat) this.stop();
    }, {capture: true});
    this.stick.addEventListener("pointerdown", (event) => {
      if (this.velocity || event.button !== 0) return;
      this.pointer = event.pointerId;
      this.centre = {x: event.clientX, y: event.clientY};
      this.stick.setPointerCapture(event.pointerId);
      this.moveStick(event);
    });
    this.stick.addEventListener("pointermove", (event) => {
      if (event.pointerId === this.pointer) this.moveStick(event);
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
      this.stick.addEventListener(name, (event) => {
        if (event.pointerId === this.pointer) this.letGo();
      });
    }
    this.stick.addEventListener("contextmenu", (event) => event.preventDefault()); // a long press
    this.turn.addEventListener("pointerdown", () => {
      if (!this.velocity) this.hold({linear: 0, angular: 0});
    });
    this.turn.addEventListener("input", () => {
      if (this.velocity) {
        this.velocity = {linear: 0, angular: -Number(this.turn.value) * this.limits.angular};
      } else {
        this.turn.value = "0"; // not held: a key or a tool moved it
      }
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture", "change", "blur"]) {
      this.turn.addEventListener(name, () => this.letGo());
    }
    document.addEventListener("visibilitychange", () => document.hidden && this.letGo());
    addEventListener("blur", () => this.letGo());
    addEventListener("pagehide", () => this.letGo());
  }

  /** Drive by the way of the pointer since it went down, wherever the stick is. */
  moveStick(event) {
    const radius = this.stick.offsetWidth / 2;
    let x = (event.clientX - this.centre.x) / radius;
    let y = (this.centre.y - event.clientY) / radius;
    const length = Math.hypot(x, y);
    if (length > 1) [x, y] = [x / length, y / length];
    this.knob.style.transform = `translate(${x * radius}px, ${-y * radius}px)`;
    const dead = (value) => Math.abs(value) < DEAD_ZONE ? 0 : value;
    this.hold({
      linear: dead(y) * this.limits.linear,
      // backwards, the stick's side is still the side to which the robot goes
      angular: -dead(x) * this.limits.angular * (y < -DEAD_ZONE ? -1 : 1),
    });
  }

  hold(velocity) {
    const begins = !this.velocity;
    this.velocity = velocity;
    if (begins) {
      this.show(true, ""); // what an earlier press or command has answered
      this.press++;
      this.sendVelocity();
      this.timer = setInterval(() => this.sendVelocity(), PERIOD);
    }
  }

  /** End the press, until the next one begins: a pointer that is still down drives no more. */
  letGo() {
    const pointer = this.pointer;
    this.pointer = null;
    if (pointer !== null && this.stick.hasPointerCapture(pointer)) {
      this.stick.releasePointerCapture(pointer);
    }
    this.knob.style.transform = "";
    this.turn.value = "0";
    if (!this.velocity) return;
    clearInterval(this.timer);
    this.velocity = {linear: 0, angular: 0};
    this.sendVelocity();
    this.velocity = null;
  }

  sendVelocity() {
    const {press} = this, {clock} = this.connection;
    this.connection.send({do: "drive", ...this.velocity, press, clock});
  }
}

function isText(target) {
  return target instanceof HTMLInputElement && !["checkbox", "radio", "range"].includes(target.type);
}
