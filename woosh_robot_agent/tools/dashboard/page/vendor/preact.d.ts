import type { VNode } from "preact";

export { Component, Fragment, h, render } from "preact";
export { useEffect, useRef, useState } from "preact/hooks";
export { batch, computed, effect, signal } from "@preact/signals";
/** Make elements from a template: the markup of JSX, with values in `${}`. */
export function html(parts: TemplateStringsArray, ...values: unknown[]): VNode;
