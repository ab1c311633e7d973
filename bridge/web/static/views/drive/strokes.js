// Converts brush strokes to runs of cells, which the console paints.

/** The cell, as [column, row] with fractions, of a place on a map; the first row is the top one. */
export function cellOf(map, x, y) {
  const { origin, resolution, height } = map;
  const [cos, sin] = [Math.cos(origin.theta), Math.sin(origin.theta)];
  const [dx, dy] = [x - origin.x, y - origin.y];
  return [(cos * dx + sin * dy) / resolution, height - (cos * dy - sin * dx) / resolution];
}

/**
 * The cells that a round brush covers along `points` ([[x, y], ...], meters), as runs [row, column, length]
 * without gaps or overlaps. `radius` in meters; 0: only the cells that the brush's center passes.
 */
export function runsOf(map, points, radius) {
  const rows = new Map(); // row -> [[first, last], ...]
  const reach = radius / map.resolution;
  const step = Math.max(0.5, reach / 4);
  let before = null;
  for (const [x, y] of points) {
    const at = cellOf(map, x, y);
    const steps = before === null ? 0 : Math.ceil(Math.hypot(at[0] - before[0], at[1] - before[1]) / step);
    for (let i = steps ? 1 : 0; i <= steps; i++) {
      const share = steps ? i / steps : 0;
      const from = before ?? at;
      dab(map, rows, from[0] + share * (at[0] - from[0]), from[1] + share * (at[1] - from[1]), reach);
    }
    before = at;
  }
  return [...rows].flatMap(([row, spans]) => joined(spans).map(([first, last]) => [row, first, last - first + 1]));
}

/** Add the cells whose centers are within `reach` of a place, and the cell that contains the place. */
function dab(map, rows, column, row, reach) {
  span(map, rows, Math.floor(row), Math.floor(column), Math.floor(column));
  for (let each = Math.ceil(row - reach - 0.5); each + 0.5 <= row + reach; each++) {
    const half = Math.sqrt(Math.max(0, reach * reach - (each + 0.5 - row) ** 2));
    span(map, rows, each, Math.ceil(column - half - 0.5), Math.floor(column + half - 0.5));
  }
}

function span(map, rows, row, first, last) {
  if (row < 0 || row >= map.height || last < 0 || first >= map.width || last < first) return;
  const spans = rows.get(row) ?? rows.set(row, []).get(row);
  spans.push([Math.max(first, 0), Math.min(last, map.width - 1)]);
  if (spans.length > 64) rows.set(row, joined(spans));
}

function joined(spans) {
  const found = [];
  for (const [first, last] of spans.sort((a, b) => a[0] - b[0])) {
    const newest = found.at(-1);
    if (newest && first <= newest[1] + 1) newest[1] = Math.max(newest[1], last);
    else found.push([first, last]);
  }
  return found;
}

/** Split runs into parts of limited runs and cells; `length` of a run is its third number. */
export function parts(runs, mostRuns, mostCells) {
  const found = [];
  let cells = Infinity;
  for (const [row, first, length, ...rest] of runs) {
    for (let done = 0; done < length; done += mostCells) {
      const piece = [row, first + done, Math.min(mostCells, length - done), ...rest];
      if (cells + piece[2] > mostCells || found.at(-1).length >= mostRuns) {
        found.push([]);
        cells = 0;
      }
      found.at(-1).push(piece);
      cells += piece[2];
    }
  }
  return found;
}
