// The texts of the page, in the language of the viewer.

import { now } from "./store.js";
import { batch, signal } from "./vendor/preact.js";

/**
 * @typedef {{key: string, values: Record<string, Value>, english?: string}} Text  a text of the dashboard;
 *   `english` is shown if the language has no text of this key
 */
/** @typedef {string | number | Text} Value  value that can be put into a text */

export const LANGUAGES = { en: "English", zh: "中文" };
const STORAGE_KEY = "woosh.language"; // in the storage of the browser
const RETRY_DELAY = 1000; // milliseconds

export const language = signal("en");
/** @type {import("@preact/signals").Signal<Record<string, string>>} */
const texts = signal({});
/** @type {import("@preact/signals").Signal<Record<string, string>>} */
const sentences = signal({}); // sentences of the program; empty for English
/** @type {import("@preact/signals").Signal<Record<string, string>>} */
const codes = signal({}); // meaning of status codes; empty for English, which the dashboard has

/**
 * Show the page in a language, and remember it.
 * @param {string} wanted
 */
export async function setLanguage(wanted) {
  await loadLanguage(wanted);
  remember(STORAGE_KEY, wanted);
}

/** Show the page in the language that was chosen, or in the language of the browser. */
export async function startLanguage() {
  const known = Object.keys(LANGUAGES);
  const chosen = remembered(STORAGE_KEY);
  const preferred = navigator.languages.map((each) => each.split("-")[0]);
  const wanted = [chosen, ...preferred].find((each) => known.includes(each));
  for (;;) {
    try {
      return await loadLanguage(wanted ?? "en");
    } catch {
      // try again: without texts, the page would not appear
      await new Promise((resolve) => setTimeout(resolve, RETRY_DELAY));
    }
  }
}

/**
 * Return what `remember` has stored in this browser; empty if it has stored nothing.
 * @param {string} key
 */
export function remembered(key) {
  try {
    return localStorage.getItem(key) ?? "";
  } catch {
    return ""; // a browser that blocks cookies has no storage
  }
}

/**
 * Store a choice of the viewer in this browser, if it has a storage.
 * @param {string} key
 * @param {string} value
 */
export function remember(key, value) {
  try {
    localStorage.setItem(key, value);
  } catch {
    console.info("The browser stores nothing: the choice ends with this page.");
  }
}

/** @param {string} wanted */
async function loadLanguage(wanted) {
  const [ownTexts, meanings, saidTexts] = await Promise.all([
    load(`texts/${wanted}.json`),
    wanted === "en" ? {} : load(`texts/codes.${wanted}.json`),
    wanted === "en" ? {} : load(`texts/said.${wanted}.json`),
  ]);
  batch(() => {
    texts.value = ownTexts;
    sentences.value = saidTexts;
    codes.value = meanings;
    language.value = wanted;
  });
  document.documentElement.lang = wanted;
}

/** @param {string} url */
async function load(url) {
  const response = await fetch(url);
  if (!response.ok) throw new Error(`${url}: ${response.status}`);
  return response.json();
}

/**
 * Return a text, with values put into it.
 * @param {string} key
 * @param {Record<string, Value>} values by the names in braces
 * @returns {string}
 */
export function t(key, values = {}) {
  return filled(texts.value[key] ?? key, values);
}

/**
 * @param {string} pattern
 * @param {Record<string, Value>} values by the names in braces
 * @returns {string}
 */
function filled(pattern, values) {
  return pattern.replace(/\{(\w+)\}/g, (_, name) => say(values[name] ?? ""));
}

/**
 * Return how many alarms there are.
 * @param {number} count
 */
export function alarmCount(count) {
  return t(count === 1 ? "alarms.one" : "alarms.count", { count });
}

/**
 * Return a text if there is one with this key, otherwise `other`.
 * @param {string} key
 * @param {string} other
 */
export function tOr(key, other) {
  return texts.value[key] ?? other;
}

/**
 * Return a value from the dashboard in the language of the page.
 * @param {Value} value
 * @returns {string}
 */
export function say(value) {
  if (typeof value !== "object") return String(value);
  const { key, values, english } = value;
  if (english === undefined) return t(key, values);
  // the sentence may also be the name of a command, or the meaning of a status code
  const known = [sentences, texts, codes].find((each) => key in each.value);
  const pattern = language.value === "en" ? undefined : known?.value[key];
  return pattern ? filled(pattern, values) : english;
}

/**
 * Return the meaning of a status code in the language of the page; empty if unknown.
 * @param {{code: string, meaning: string}} code with the meaning in English
 */
export function meaningOf({ code, meaning }) {
  const known = codes.value;
  if (!meaning) return ""; // in no table, or ambiguous without the level: do not guess
  if (code in known) return known[code];
  // robots report some codes with another level, which is the last digit
  const other = Object.keys(known).find((each) => each.slice(0, -1) === code.slice(0, -1));
  return other ? known[other] : meaning;
}

/**
 * Return a time of the day.
 * @param {number} time Unix time, in milliseconds
 */
export function clock(time) {
  return new Date(time).toLocaleTimeString("en-GB");
}

/**
 * Return a time of the day, with the date if it is not today.
 * @param {number} time Unix time, in milliseconds
 */
export function moment(time) {
  const date = new Date(time);
  const today = new Date(now()).toDateString() === date.toDateString();
  return today ? clock(time) : `${date.toLocaleDateString(language.value)} ${clock(time)}`;
}
