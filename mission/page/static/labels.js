// Words on the map that do not lie over each other, and candidates that overlap drawn as one. Pure: no drawing here.

// Candidates nearer than `near_px` to a more probable one are its group: a dozen rings on one metre say nothing.
export function grouped(sources, toPixels, near_px) {
  const rank = (source) => (source.state === "candidate" ? source.p : 2 + source.p);
  const groups = [];
  for (const source of [...sources].sort((a, b) => rank(b) - rank(a))) {
    const [x, y] = toPixels([source.east_m, source.north_m]);
    const home = source.state === "candidate" && groups.find((group) => Math.hypot(group.x - x, group.y - y) < near_px);
    if (home) home.also.push(source);
    else groups.push({ source, x, y, also: [] });
  }
  return groups;
}

// Where words of this size go beside a point: the first of four corners that is free, or the first of all.
export class Places {
  constructor(width, height, top = 46) { this.taken = [[0, 0, width, top]]; this.width = width; this.height = height; } // buttons lie over the top

  block(x, y, half) { this.taken.push([x - half, y - half, x + half, y + half]); }

  place(x, y, width, height, gap = 9) {
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
