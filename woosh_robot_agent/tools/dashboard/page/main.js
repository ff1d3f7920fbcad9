// Starts the page: loads the texts, shows all views, and keeps the title, the tool and the focus right.

import { effect, html, render } from "./vendor/preact.js";
import { connection, forgetTarget } from "./commands.js";
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
  // hides the token, which the cookie has now
  history.replaceState(null, "", location.pathname + location.hash);
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
document.body.replaceChildren(); // ends the text that the page is being loaded
render(html`<${App} />`, document.body);

effect(() => {
  const robot = store.robot.value;
  document.title = robot?.known ? robotName(robot) : t("page.title");
});
effect(() => {
  if (store.robots.value.length > 1) history.replaceState(null, "", `#${store.address.value}`);
});
store.mayControl.subscribe((may) => {
  forgetTarget(); // also ends what was begun on the map
  store.tool.value = may ? "go" : "move";
});

// If the focused control disappears or is disabled, what contained it gets the focus.
let focusPath = /** @type {EventTarget[]} */ ([]); // the focused control, and all that contains it
addEventListener("pointerdown", () => (focusPath = []), { capture: true }); // a press may focus nothing
addEventListener("focusin", (event) => (focusPath = event.composedPath()));
new MutationObserver(() => {
  const [focused, ...containers] = /** @type {HTMLElement[]} */ (focusPath);
  if (!focused || (focused.isConnected && !focused.matches?.(":disabled"))) return;
  if (![document.body, focused].includes(/** @type {any} */ (document.activeElement))) return;
  const nearest = containers.find((each) => each.isConnected && !each.matches?.(":disabled"));
  if (!nearest || nearest === document.body) return;
  nearest.tabIndex = -1;
  nearest.focus();
}).observe(document.body, { childList: true, subtree: true, attributeFilter: ["disabled"] });
Object.assign(globalThis, { store, connection }); // for the console of the browser, and for tests
