// Formats numbers for people, with constant width.

const NONE = "–";

const known = (value) => typeof value === "number" && Number.isFinite(value);

/** Meters. */
export const meters = (value, digits = 2) => (known(value) ? `${value.toFixed(digits)} m` : NONE);

/** An angle in degrees, -180 to 180. */
export function degrees(radians) {
  if (!known(radians)) return NONE;
  const turn = Math.round((wrapped(radians) * 180) / Math.PI);
  return `${turn === -180 ? 180 : turn}°`;
}

/** An angle within -pi to pi. */
export const wrapped = (radians) => Math.atan2(Math.sin(radians), Math.cos(radians));

/** A position as text. */
export const position = (x, y) => `${x.toFixed(2)}, ${y.toFixed(2)}`;

/** A rate in Hz. */
export const rate = (value) => (known(value) ? `${value.toFixed(value < 100 ? 1 : 0)} Hz` : NONE);

/** A number of bytes. */
export function bytes(value) {
  if (!known(value)) return NONE;
  for (const [unit, size] of [["GB", 1e9], ["MB", 1e6], ["kB", 1e3]]) {
    if (value >= size) return `${(value / size).toFixed(value < 10 * size ? 1 : 0)} ${unit}`;
  }
  return `${Math.round(value)} B`;
}

/** A time span. */
export function seconds(value) {
  if (!known(value)) return NONE;
  if (Math.abs(value) < 1) return `${(value * 1000).toFixed(Math.abs(value) < 0.01 ? 1 : 0)} ms`;
  return value < 100 ? `${value.toFixed(1)} s` : `${Math.round(value)} s`;
}

/** The time of day, from seconds since 1970. */
export function clock(value) {
  const date = new Date(value * 1000);
  const two = (part) => String(part).padStart(2, "0");
  return `${two(date.getHours())}:${two(date.getMinutes())}:${two(date.getSeconds())}.${String(date.getMilliseconds()).padStart(3, "0")}`;
}

/** A share in percent. */
export const percent = (value) => (known(value) ? `${Math.round(value * 100)} %` : NONE);

/** A count. */
export const count = (value) => (known(value) ? String(value) : NONE);

/** Any number of a message, with its significant digits. */
export function number(value) {
  if (!known(value)) return String(value);
  if (Number.isInteger(value)) return String(value);
  const size = Math.abs(value);
  return size >= 1e6 || size < 1e-4 ? value.toExponential(3) : value.toFixed(size < 1 ? 4 : size < 1000 ? 3 : 1);
}
