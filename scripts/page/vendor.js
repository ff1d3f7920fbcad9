// Make the vendored libraries of the page: `node vendor.js`, or with --check, compare them.

import { mkdir, readFile, writeFile } from "node:fs/promises";
import { build } from "esbuild";

const TARGET = new URL("../../woosh_robot_agent/tools/dashboard/page/vendor/", import.meta.url);
const MODULES = new URL("node_modules/", import.meta.url);

/** The libraries in each file, and its source. */
const FILES = {
  "preact.js": {
    libraries: ["preact", "@preact/signals", "@preact/signals-core", "htm"],
    source: `import { h } from "preact";
      import htm from "htm";
      export { Component, Fragment, h, render } from "preact";
      export { useEffect, useRef, useState } from "preact/hooks";
      export { batch, computed, effect, signal } from "@preact/signals";
      export const html = htm.bind(h);`,
  },
  "uplot.js": { libraries: ["uplot"], source: `export { default } from "uplot";` },
};

async function library(name) {
  const folder = new URL(`${name}/`, MODULES);
  const { version } = JSON.parse(await readFile(new URL("package.json", folder), "utf8"));
  return { name, version, licence: (await readFile(new URL("LICENSE", folder), "utf8")).trim() };
}

/** Return the content of all files, by their names. */
async function make() {
  const files = {};
  const licences = [];
  for (const [file, { libraries, source }] of Object.entries(FILES)) {
    const known = await Promise.all(libraries.map(library));
    licences.push(...known);
    const { outputFiles } = await build({
      stdin: { contents: source, resolveDir: new URL(".", import.meta.url).pathname },
      bundle: true,
      format: "esm",
      minify: true,
      legalComments: "none",
      write: false,
    });
    const names = known.map(({ name, version }) => `${name} ${version}`).join(", ");
    files[file] = `/* ${names}; licences in LICENSES, made by scripts/page/vendor.js */\n`;
    files[file] += outputFiles[0].text;
  }
  files["uplot.css"] = await readFile(new URL("uplot/dist/uPlot.min.css", MODULES), "utf8");
  files.LICENSES = licences
    .map(({ name, version, licence }) => `${name} ${version}\n\n${licence}\n`)
    .join(`\n${"-".repeat(78)}\n\n`);
  return files;
}

const check = process.argv.includes("--check");
await mkdir(TARGET, { recursive: true });
for (const [name, content] of Object.entries(await make())) {
  const file = new URL(name, TARGET);
  if (!check) {
    await writeFile(file, content);
  } else if ((await readFile(file, "utf8").catch(() => "")) !== content) {
    console.error(`page/vendor/${name} is not what package.json says: run npm run vendor`);
    process.exitCode = 1;
  }
}
