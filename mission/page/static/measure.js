// @ts-check
// Two taps on the map: how far, and in which direction.
/** @import { Place } from "./mapview.js" */

export const measure = {
  on: false,
  /** @type {Place[]} */
  points: [],
  toggle() { this.on = !this.on; this.points = []; },
  /** @param {Place} point */
  take(point) { this.points = this.points.length === 2 ? [point] : [...this.points, point]; },
};

/** @param {Place} from @param {Place} to */
export function said([east, north], [east2, north2]) {
  const [de, dn] = [east2 - east, north2 - north];
  const length = Math.hypot(de, dn);
  const bearing = (Math.round((Math.atan2(de, dn) * 180) / Math.PI) + 360) % 360;
  const words = length >= 1000 ? `${(length / 1000).toFixed(2)} km` : `${length.toFixed(length < 100 ? 1 : 0)} m`;
  return `${words}, ${String(bearing).padStart(3, "0")}°`;
}
