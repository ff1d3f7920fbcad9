// What only a simulated robot has: obstacles, faults, the emergency stop and the key.

import {element} from "./panel.js";

export class Simulator {
  /** @param {import("./controls.js").Controls} controls runs commands */
  constructor(controls) {
    this.controls = controls;
    this.known = null;
    this.faults = [];
    const on = (selector, event, call) =>
      document.querySelector(selector).addEventListener(event, call);
    on("#emergency-stop", "click", () => this.toggle("emergency_stop"));
    on("#key-switch", "click", () => this.toggle("key_switch"));
    on("#clear-faults", "click", () => this.controls.run("clearFaults"));
    on("#fault-name", "change", () => this.describe());
    on("#fault", "submit", (event) => {
      event.preventDefault();
      const name = document.querySelector("#fault-name").value;
      const args = document.querySelector("#fault-arguments").value;
      this.controls.run("fault", {text: `${name} ${args}`.trim()});
      document.activeElement.blur(); // the space bar stops again
    });
  }

  /** Begin a fault, or end it if it is active. */
  toggle(name) {
    const active = this.faults.find((fault) => fault.name === name);
    if (active) this.controls.run("endFault", {id: active.id});
    else this.controls.run("fault", {text: name});
  }

  /** Put an obstacle, or remove the one that was clicked. */
  clicked({x, y}, obstacle) {
    if (obstacle) this.controls.run("endFault", {id: obstacle.id});
    else this.controls.run("fault", {text: `obstacle x=${x.toFixed(3)} y=${y.toFixed(3)}`});
  }

  show({known, faults}) {
    this.faults = faults;
    if (!this.known) {
      this.known = known;
      document.querySelector("#fault-name").replaceChildren(
        ...known.map(({name}) => element("option", name)));
      this.describe();
      for (const each of document.querySelectorAll(".simulated")) each.hidden = false;
      document.querySelector("#tools").hidden = false;
    }
    for (const [selector, name] of [["#emergency-stop", "emergency_stop"], ["#key-switch", "key_switch"]]) {
      const active = faults.some((fault) => fault.name === name);
      document.querySelector(selector).setAttribute("aria-pressed", String(active));
    }
    document.querySelector("#faults").replaceChildren(...faults.map((fault) => {
      const line = element("li", "");
      const end = element("button", "End");
      end.type = "button";
      end.addEventListener("click", () => this.controls.run("endFault", {id: fault.id}));
      line.append(end, ` ${fault.text}`);
      return line;
    }));
  }

  describe() {
    const name = document.querySelector("#fault-name").value;
    const fault = this.known.find((each) => each.name === name);
    document.querySelector("#fault-description").textContent =
      fault.arguments ? `${fault.description}. Arguments: ${fault.arguments}` : fault.description;
  }
}
