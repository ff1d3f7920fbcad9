// The page: connects the view, the panel and the controls to the dashboard.

import {Connection} from "./connection.js";
import {Controls} from "./controls.js";
import {MapView} from "./map_view.js";
import {showCodes, showPose, showRobot} from "./panel.js";
import {Simulator} from "./simulator.js";

const find = (selector) => document.querySelector(selector);

if (new URLSearchParams(location.search).has("token")) {
  history.replaceState(null, "", location.pathname); // the cookie has the token now
}

const view = new MapView(find("#map"));
globalThis.mapView = view; // for the console of the browser, and for tests
let you = "";
let problem = "connecting"; // why nothing comes from the dashboard; empty if it does
let known = false; // the robot has reported its state
let link = {good: false, text: "", detail: ""};
let robotIndex = 0; // of the robot that is chosen
let toolChosen = false;
let shownMap = ""; // address of the map picture
let watching = 0; // index of the robot whose parts arrive

const parts = {
  hello: ({you: name, control, robots}) => {
    you = name;
    shownMap = ""; // another process may use the same number for another map
    if (control) controls.enable();
    const list = find("#robots");
    list.hidden = robots.length < 2;
    list.replaceChildren(...robots.map((address, index) => new Option(address, index)));
    list.value = String(robotIndex);
  },
  link: (data) => {
    link = data;
    showLink();
  },
  robots: (summaries) => summaries.forEach((text, index) => {
    const option = find("#robots").options[index];
    if (option.text !== text) option.text = text;
  }),
  robot: (robot) => {
    known = robot.known;
    controls.showModes(robot.modes);
    showRobot(robot);
    showLink();
  },
  pose: (pose) => {
    showPose(pose);
    view.setPose(pose);
    endAlarm();
  },
  outline: (outline) => view.set("outline", outline),
  path: (path) => view.set("path", path),
  codes: showCodes,
  map: (map) => {
    find("#map-error").hidden = !map.error;
    find("#map-error").textContent = map.error ? `no map: ${map.error}` : "";
    const url = `map/${robotIndex}/${map.number}.png`;
    if (url !== shownMap) view.setMap(map, url);
    shownMap = url;
  },
  control: ({owner, limits}) => {
    controls.limits = limits;
    const mine = owner === you;
    find("#owner").textContent = !owner ? "" : mine ? "you have control" : `${owner} has control`;
    find("#release").hidden = !mine;
  },
  stick: (text) => {
    controls.letGo();
    showMessage(false, text);
  },
  simulator: (data) => {
    simulator.show(data);
    view.set("obstacles", data.faults.filter((fault) => fault.x !== undefined));
    if (!toolChosen) chooseTool("go");
  },
};

const robotParts = new Set(
  ["link", "robot", "pose", "outline", "path", "codes", "map", "control", "simulator"]);

const connection = new Connection(
  (name, data) => {
    if (name === "watching") watching = data;
    else if (robotParts.has(name) && watching !== robotIndex) return; // of the former robot
    else parts[name]?.(data);
  },
  (scan) => {
    if (watching === robotIndex) view.setScan(scan);
  },
  (reason) => {
    problem = reason;
    if (problem) controls.letGo();
    showLink();
  },
);
const controls = new Controls(connection, showMessage, showAlarm);
globalThis.controls = controls; // for tests
const simulator = new Simulator(controls);

view.onAct = (tool, place, theta, mark, obstacle) => {
  if (tool === "obstacle") {
    simulator.clicked(place, obstacle);
    return;
  }
  if (tool === "go" && mark) {
    controls.run("goMark", {mark: mark.number});
    return;
  }
  // without a direction: the way from the robot to the place, or as it stands
  const pose = view.pose;
  let direction = theta;
  if (direction === null) {
    direction = !pose ? 0
      : tool === "setPose" ? pose.theta : Math.atan2(place.y - pose.y, place.x - pose.x);
  }
  controls.run(tool, {x: place.x, y: place.y, theta: direction});
};
view.corner = () => {
  const stick = find("#stick"), stage = find("#stage").getBoundingClientRect();
  if (stick.hidden) return [0, 0];
  const box = stick.getBoundingClientRect();
  return [stage.right - box.left, stage.bottom - box.top];
};
view.onFollow = (follow) => { find("#follow").checked = follow; };

find("#zoom-in").addEventListener("click", () => view.zoom(1.4));
find("#zoom-out").addEventListener("click", () => view.zoom(1 / 1.4));
find("#fit").addEventListener("click", () => {
  view.follow = find("#follow").checked = false;
  view.fit();
});
find("#follow").addEventListener("change", ({target}) => {
  view.set("follow", target.checked);
  if (view.pose) view.setPose(view.pose);
});
find("#robots").addEventListener("change", ({target}) => {
  controls.letGo();
  robotIndex = Number(target.value);
  controls.modes = [];
  view.forget();
  connection.watch(robotIndex);
});
for (const radio of document.querySelectorAll("[name=tool]")) {
  radio.addEventListener("change", () => chooseTool(radio.value));
}

function chooseTool(tool) {
  toolChosen = true;
  view.tool = tool;
  find(`[name=tool][value=${tool}]`).checked = true;
}

function showLink() {
  const good = link.good && !problem;
  const status = find("#link");
  status.textContent = problem || link.text;
  status.title = problem ? "" : link.detail;
  status.className = good ? "good" : "bad";
  find("#outdated").hidden = good;
  find("#outdated").textContent =
    known ? "OUTDATED: this is the last known state" : "The robot has not reported its state yet";
  document.body.classList.toggle("outdated", !good);
  endAlarm();
}

/** Hide the alarm of an unconfirmed stop once the robot is seen to stand still. */
function endAlarm() {
  const {pose} = view;
  if (link.good && !problem && pose && !pose.linear && !pose.angular) showAlarm("");
}

function showAlarm(text) {
  find("#alarm").hidden = !text;
  find("#alarm").textContent = text;
}

function showMessage(ok, text) {
  const message = find("#message");
  message.textContent = text;
  message.className = ok ? "good" : "bad";
}
