// @ts-check
// How a person says a number: the same words in all panels.
/** @import { Source } from "./protocol" */

/** @param {number | null} value */
export function metres(value) { return value === null ? "" : `${value.toFixed(value < 10 ? 1 : 0)} m`; }

// "within 0.3 m, 90 % sure"; of one that is not placed yet, how probably it is here at all.
/** @param {Source} source */
export function sureness(source) {
  const [long] = source.half_axes_m;
  if (source.state === "outside" || source.state === "removed") return source.state;
  return long === null ? "" : `within ${metres(long)}, 90 % sure`;
}
/** @type {Record<Source["state"], string>} */
export const STATES = { found: "found", candidate: "candidate", inconsistent: "inconsistent", removed: "removed", outside: "outside the field" };
