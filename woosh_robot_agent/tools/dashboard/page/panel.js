// The state of the robot in words.

const LOW_BATTERY = 20; // percent

/** Return an element with a text, which the browser never takes for HTML. */
export function element(tag, text, className = "") {
  const made = document.createElement(tag);
  made.textContent = text;
  made.className = className;
  return made;
}

/** Show the state of the robot, except its pose. */
export function showRobot(robot) {
  const title = [robot.id || "", robot.name !== String(robot.id) ? robot.name : "", robot.model];
  document.querySelector("#title").textContent = title.filter(Boolean).join(" ") || "Robot";
  const list = document.querySelector("#state");
  const pose = [...list.querySelectorAll(".pose")];
  list.replaceChildren();
  const row = (name, ...content) => {
    const value = document.createElement("dd");
    value.append(...content);
    list.append(element("dt", name), value);
  };
  if (!robot.known) {
    row("robot", element("span", "unknown", "faint"));
    return;
  }
  row("state", robot.state);
  row("mode", robot.control ? modes(robot) : "unknown");
  if (robot.emergencyStop) row("", element("span", "the emergency stop is pressed", "bad"));
  row("new task", ...newTask(robot));
  row("battery", battery(robot.battery));
  row("task", ...task(robot.task));
  for (const each of robot.actions) row(each.name, `${each.state} ${each.text}`);
  row("map", [robot.scene, robot.map].filter(Boolean).join(", ") || "none");
  if (robot.problems.length) {
    row("problems", ...robot.problems.map((text) => element("div", text, "bad")));
  } else {
    row("problems", element("span", "none", "faint"));
  }
  list.append(...pose);
}

/** Show pose and speed. */
export function showPose(pose) {
  const list = document.querySelector("#state");
  let value = list.querySelector("dd.pose");
  if (!value) {
    value = element("dd", "", "pose");
    list.append(element("dt", "pose", "pose"), value);
  }
  value.textContent = pose
    ? `x ${pose.x.toFixed(2)} m, y ${pose.y.toFixed(2)} m, ${degrees(pose.theta)}°; ` +
      `${pose.linear.toFixed(2)} m/s, ${pose.angular.toFixed(2)} rad/s`
    : "unknown";
  if (pose?.doubt) value.textContent += ` (${pose.doubt})`;
}

/** Show the last status codes. */
export function showCodes(codes) {
  document.querySelector("#codes").replaceChildren(...codes.map((code) =>
    element("li", `${code.time} ${code.level} ${code.text}`,
      {fault: "bad", warn: "warning"}[code.level] ?? "")));
}

/** Return the modes, named as in the lists that set them. */
function modes(robot) {
  const name = (list, number, other) =>
    document.querySelector(`${list} option[value="${number}"]`)?.textContent ?? other;
  const [control, work] = robot.modes;
  return `control ${name("#control-mode", control, robot.control)}, ` +
    `work ${name("#work-mode", work, robot.work)}`;
}

function newTask(robot) {
  if (robot.objections.length) {
    return [
      element("span", "would be rejected", "bad"),
      ...robot.objections.map(([reason, remedy]) => {
        const line = element("div", "");
        line.append(element("span", `${reason}: `, "bad"), remedy);
        return line;
      }),
    ];
  }
  if (robot.taskable === null) return [element("span", "unknown", "faint")];
  return [element("span", "would be accepted", "good")];
}

function battery(value) {
  if (!value) return element("span", "unknown", "faint");
  const low = value.power <= LOW_BATTERY && !value.charging;
  const text = `${value.power} %${value.charging ? ", charging" : ""}`;
  return element("span", text, low ? "warning" : "");
}

function task(value) {
  if (!value) return [element("span", "none", "faint")];
  const tone = {failed: "bad", completed: "good"}[value.state] ?? "";
  const parts = [element("span", value.state, tone), ` ${value.type}`];
  if (value.to) parts.push(` to ${value.to}`);
  parts.push(` (${value.id})`);
  if (value.action) parts.push(element("div", `${value.action}: ${value.actionState}`));
  if (value.text) parts.push(element("div", value.text));
  if (value.reason) parts.push(element("div", value.reason, "bad"));
  return parts;
}

function degrees(angle) {
  return (angle * 180 / Math.PI).toFixed(0);
}
