// The page: its views, in the language of its reader.

import { effect, html, render } from "./vendor/preact.js";
import { connection } from "./commands.js";
import * as store from "./store.js";
import { startLanguage, t } from "./texts.js";
import { Bar } from "./views/bar.js";
import { Dock, ReadOnly } from "./views/dock.js";
import { Panel, Tabs } from "./views/panel.js";
import { robotName } from "./views/parts.js";
import { startTheme } from "./views/setup.js";
import { Stage } from "./views/stage.js";
import "./drive.js";

if (new URLSearchParams(location.search).has("token")) {
  history.replaceState(null, "", location.pathname); // the cookie has the token now
}

function App() {
  return html`<${Bar} />
    <${Stage} />
    <${Tabs} />
    <${Panel} />
    ${store.you.value && !store.mayControl.value ? html`<${ReadOnly} />` : html`<${Dock} />`}`;
}

startTheme();
await startLanguage();
render(html`<${App} />`, document.body);

effect(() => {
  const robot = store.robot.value;
  document.title = robot?.known ? robotName(robot) : t("page.title");
});
let tooled = false; // true once a viewer with control has got the tool "go"
effect(() => {
  if (!store.mayControl.value || tooled) return;
  tooled = true;
  store.tool.value = "go";
});

// A focused control that disappears leaves the focus to what is left around it.
let around = /** @type {EventTarget[]} */ ([]); // the focused control, and what contains it
addEventListener("pointerdown", () => (around = []), { capture: true });
addEventListener("focusin", (event) => (around = event.composedPath()));
new MutationObserver(() => {
  const [focused, ...others] = /** @type {HTMLElement[]} */ (around);
  if (!focused || focused.isConnected || document.activeElement !== document.body) return;
  const left = others.find((each) => each.isConnected);
  if (!left || left === document.body) return;
  left.tabIndex = -1;
  left.focus();
}).observe(document.body, { childList: true, subtree: true });
Object.assign(globalThis, { store, connection }); // for the console of the browser, and for tests
