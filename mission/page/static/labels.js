// @ts-check
// Words on the map that do not lie over each other, and candidates that overlap drawn as one. Pure: no drawing here.
/** @import { Place, Pixel } from "./mapview.js" */
/** @import { Source } from "./protocol" */
/** @typedef {{ source: Source, x: number, y: number, also: Source[] }} Group */
/** @typedef {[left: number, top: number, right: number, bottom: number]} Box */

// Candidates nearer than `near_px` to a more probable one are its group: a dozen rings on one metre say nothing.
/** @param {Source[]} sources @param {(place: Place) => Pixel} toPixels @param {number} near_px */
export function grouped(sources, toPixels, near_px) {
  /** @param {Source} source */
  const rank = (source) => (source.state === "candidate" ? source.p : 2 + source.p);
  /** @type {Group[]} */
  const groups = [];
  for (const source of [...sources].sort((a, b) => rank(b) - rank(a))) {
    const [x, y] = toPixels([source.east_m, source.north_m]);
    const home = source.state === "candidate" ? groups.find((group) => Math.hypot(group.x - x, group.y - y) < near_px) : null;
    if (home) home.also.push(source);
    else groups.push({ source, x, y, also: [] });
  }
  return groups;
}

// Where words of this size go beside a point: the first of four corners that is free, or the first of all.
export class Places {
  /** @param {number} width @param {number} height @param {number} top buttons lie over it */
  constructor(width, height, top = 46) {
    /** @type {Box[]} */
    this.taken = [[0, 0, width, top]];
    this.width = width;
    this.height = height;
  }

  /** @param {number} x @param {number} y @param {number} half */
  block(x, y, half) { this.taken.push([x - half, y - half, x + half, y + half]); }

  /** @param {number} x @param {number} y @param {number} width @param {number} height @param {number} gap */
  place(x, y, width, height, gap = 9) {
    /** @type {Pixel[]} */
    const corners = [
      [x + gap, y - gap - height + 4], [x + gap, y + gap - 4], [x - gap - width, y - gap - height + 4], [x - gap - width, y + gap - 4],
      [x - width / 2, y + gap + 4], [x - width / 2, y - gap - height - 4],
    ];
    const inside = corners.filter(([left, top]) => left >= 2 && left + width <= this.width - 2 && top >= 2 && top + height <= this.height - 2);
    const free = inside.find(([left, top]) => !this.taken.some((box) => left < box[2] && left + width > box[0] && top < box[3] && top + height > box[1]));
    const [left, top] = free ?? inside[0] ?? corners[0];
    this.taken.push([left, top, left + width, top + height]);
    return { left, top, free: Boolean(free) };
  }
}
