// The panel: tabs, and the content of the chosen tab. On a small screen: a sheet over the map.

import { html, useEffect, useState } from "../vendor/preact.js";
import { openTab } from "../commands.js";
import * as store from "../store.js";
import { t } from "../texts.js";
import { Fleet } from "./fleet.js";
import { Go } from "./go.js";
import { MapTab } from "./map_tab.js";
import { wrongCount, wrongTone } from "./notices.js";
import { compact, Icon } from "./parts.js";
import { Setup } from "./setup.js";
import { Simulator } from "./simulator.js";
import { State } from "./state.js";
import { Tasks } from "./tasks.js";

/** @type {Record<string, {icon: string, view: () => unknown}>} */
const TABS = {
  fleet: { icon: "fleet", view: Fleet },
  go: { icon: "go", view: Go },
  tasks: { icon: "tasks", view: Tasks },
  state: { icon: "state", view: State },
  map: { icon: "map", view: MapTab },
  setup: { icon: "setup", view: Setup },
  simulator: { icon: "simulator", view: Simulator },
};

/** Return the names of the visible tabs. One robot has the fleet tab if it has an order. */
function visibleTabs() {
  const cards = store.fleet.value;
  const hasFleet = cards.length > 1 || cards.some((card) => card.order);
  return Object.keys(TABS).filter(
    (name) =>
      (name !== "fleet" || hasFleet) && (name !== "simulator" || store.simulator.value !== null),
  );
}

/** @param {string} name */
function pressTab(name) {
  if (compact.matches && store.tab.value === name && store.sheet.value !== "closed") {
    store.sheet.value = "closed";
  } else {
    openTab(name);
  }
}

export function Tabs() {
  const isCompact = useMatches();
  const open = !isCompact || store.sheet.value !== "closed";
  const tabs = visibleTabs();
  const problems = wrongCount.value;
  /** @param {KeyboardEvent} event */
  const move = (event) => {
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    const index = tabs.indexOf(store.tab.value) + step;
    const next = tabs[(index + tabs.length) % tabs.length];
    openTab(next);
    document.getElementById(`tab-${next}`)?.focus();
  };
  return html`<nav class="tabs" aria-label=${t("panel.name")}>
    <div role="tablist" aria-label=${t("panel.name")} onKeyDown=${move}>
      ${tabs.map((name) => {
        const selected = open && store.tab.value === name;
        return html`<button
          type="button"
          role="tab"
          key=${name}
          id=${`tab-${name}`}
          aria-selected=${selected}
          aria-controls="panel"
          tabindex=${store.tab.value === name ? 0 : -1}
          onClick=${() => pressTab(name)}
        >
          <${Icon} name=${TABS[name].icon} />
          <span>${t(name === "go" && !store.mayControl.value ? "marks.name" : `tab.${name}`)}</span>
          ${name === "state" && problems > 0 && html`<span class="badge ${wrongTone.value}">${problems}</span>`}
        </button>`;
      })}
    </div>
  </nav>`;
}

export function Panel() {
  const isCompact = useMatches();
  const name = visibleTabs().includes(store.tab.value) ? store.tab.value : "go";
  const size = isCompact ? store.sheet.value : "half";
  const full = size === "full";
  // the fleet tab tells the state of each link by itself, as long as it is updated
  const showsOther =
    name === "simulator" || (name === "fleet" && store.link.value?.state !== "failed");
  const old = store.outdated.value && !showsOther;
  return html`<aside
    class="panel ${isCompact ? `over ${size}` : ""}"
    aria-label=${t("panel.name")}
    hidden=${size === "closed"}
  >
    ${
      isCompact &&
      html`<div class="handle">
        <button
          type="button"
          class="quiet"
          aria-label=${t(full ? "panel.smaller" : "panel.larger")}
          onClick=${() => (store.sheet.value = full ? "half" : "full")}
        >
          <span></span>
        </button>
        <button
          type="button"
          class="quiet"
          aria-label=${t("panel.close")}
          onClick=${() => (store.sheet.value = "closed")}
        >
          <${Icon} name="close" />
        </button>
      </div>`
    }
    <p class="stale" hidden=${!old}>
      ${t(store.robot.value?.known ? "notice.outdated" : "notice.unknown")}
    </p>
    <div
      id="panel"
      class=${old ? "old" : ""}
      role="tabpanel"
      aria-labelledby=${`tab-${name}`}
      tabindex="-1"
    >
      <${TABS[name].view} key=${name} />
    </div>
  </aside>`;
}

/** Return true if the screen matches a query; a change renders the component anew. */
export function useMatches(query = compact) {
  const [matches, setMatches] = useState(query.matches);
  useEffect(() => {
    const change = () => setMatches(query.matches);
    query.addEventListener("change", change);
    return () => query.removeEventListener("change", change);
  }, []);
  return matches;
}
