// The page: connects the view, the panel and the controls to the dashboard.

import {Connection} from "./connection.js";
import {Controls} from "./controls.js";
import {MapView} from "./map_view.js";
import {showCodes, showPose, showRobot} from "./panel.js";
import {Simulator} from "./simulator.js";

const STANDSTILL = 1000; // milliseconds for which a robot must stand still to end its alarm

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
const alarms = new Map(); // why stops have failed, by the index of the robot
let standingSince = 0; // time since which the robot is seen to stand still

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
    checkAlarm();
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
  result: (result) => {
    show("#result", result?.text ?? "", result?.tone, result?.time);
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
  ["link", "robot", "pose", "outline", "path", "codes", "map", "control", "result", "simulator"]);

const connection = new Connection(
  (name, data) => {
    if (name === "watching") watching = data;
    else if (robotParts.has(name) && watching !== robotIndex) return; // of the former robot
    else parts[name]?.(data);
  },
  (scan) => {
    if (watching !== robotIndex) return;
    view.setScan(scan);
    checkAlarm();
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
  const {pose} = view;
  if (tool === "setPose" && theta === null) {
    showMessage(false, "Set pose: press where the robot is, and drag in its direction");
    return;
  }
  // without a direction: that from the robot to the place
  const direction = theta ?? (pose ? Math.atan2(place.y - pose.y, place.x - pose.x) : 0);
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
  link = {good: false, text: "", detail: ""}; // until that of the new one arrives
  showMessage(true, "");
  parts.result(null);
  checkAlarm();
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
  checkAlarm();
}

/** End the alarm of an unconfirmed stop once that robot is seen to stand still for a while. */
function checkAlarm() {
  const {pose} = view, now = performance.now();
  const seen = link.good && !problem && watching === robotIndex;
  if (!(seen && pose && !pose.linear && !pose.angular)) standingSince = now;
  if (now - standingSince > STANDSTILL) showAlarm("", robotIndex);
}

/** Show that a stop of a robot has failed; without a text, that it has not. */
function showAlarm(text, robot) {
  alarms.delete(robot);
  if (text) alarms.set(robot, `${text}${ofRobot(robot)}`);
  standingSince = performance.now();
  find("#alarm").hidden = !alarms.size;
  if (!alarms.size) find("#alarm details").open = false;
  find("#alarm summary span").textContent = [...alarms.values()].join("; ");
}

function showMessage(ok, text, robot = robotIndex) {
  show("#message", text && `${text}${robot === robotIndex ? "" : ofRobot(robot)}`, ok ? "" : "bad");
}

/** Show a text after the time of what it tells. */
function show(selector, text, tone = "", time = Date.now()) {
  const clock = new Date(time).toLocaleTimeString("en-GB");
  find(selector).textContent = text && `${clock} ${text}`;
  find(selector).className = tone;
}

/** Return which robot something is about, if there are several. */
function ofRobot(robot) {
  const {options} = find("#robots");
  return options.length > 1 ? ` (${options[robot].text.split(": ")[0]})` : "";
}
