// A wanted path (time in s, displacement in um): its points, its samples, and its voltage from the WebAssembly of the
// model, whose displacements are in metres.
const MICRO = 1e-6;
export const MOST_SAMPLES = 2_000_000;

// Straight lines between points, sampled at `rate` (Hz) like on the server.
export function sampled(points, rate) {
  const begin = points[0][0];
  const count = Math.round((points.at(-1)[0] - begin) * rate) + 1;
  if (!(count >= 2)) throw new Error(`${rate} Hz gives fewer than two samples; give a higher rate.`);
  if (count > MOST_SAMPLES) {
    throw new Error(`${rate} Hz gives ${count} samples, and at most ${MOST_SAMPLES} are drawn; give a lower rate.`);
  }
  const time = new Float64Array(count);
  const wanted = new Float64Array(count);
  let k = 0;
  for (let i = 0; i < count; i += 1) {
    const t = begin + i / rate;
    while (k < points.length - 2 && points[k + 1][0] <= t) k += 1;
    const [[t0, y0], [t1, y1]] = [points[k], points[k + 1]];
    time[i] = t;
    wanted[i] = t >= t1 ? y1 : y0 + ((y1 - y0) * (t - t0)) / (t1 - t0);
  }
  return { time, wanted };
}

// Points with one moved. Its time stays between those of its neighbours, with a distance of `gap` seconds; the time of
// the first point does not change.
export function moved(points, index, [time, displacement], gap) {
  const low = index === 0 ? points[0][0] : points[index - 1][0] + gap;
  const high = index === 0 ? points[0][0] : (points[index + 1]?.[0] ?? Infinity) - gap;
  const at = Math.min(Math.max(time, low), Math.max(low, high));
  return points.map((point, k) => (k === index ? [at, displacement] : point));
}

// Points with one more; the same points if it is closer than `gap` seconds to another.
export function inserted(points, [time, displacement], gap) {
  if (points.some((point) => Math.abs(point[0] - time) < gap) || time < points[0][0]) return points;
  return [...points, [time, displacement]].sort((point, other) => point[0] - other[0]);
}

// Points without one. At least two points stay, and the first is never removed.
export function removed(points, index) {
  return points.length <= 2 || index <= 0 ? points : points.filter((_, k) => k !== index);
}

// Voltages for wanted displacements, and the displacements that they reach.
export function plan(compensator, wanted) {
  compensator.reset();
  const metres = Float64Array.from(wanted, (y) => MICRO * y);
  compensator.lead(metres[0]);
  const { voltage, displacement, clamped } = compensator.trajectory(metres);
  const reached = Float32Array.from(displacement, (y) => y / MICRO);
  const count = (code) => clamped.reduce((sum, found) => sum + (found === code), 0);
  return {
    voltage,
    reached,
    clamped,
    missed: largestDifference(reached, wanted),
    clamps: { limited: count(1), slewed: count(2) },
    steepest: compensator.period ? largestDifference(voltage.subarray(1), voltage) / compensator.period : NaN,
  };
}

// The largest mean speed of a branch (V a sample), defined as for the records of a model; turns of less than `band`
// volts are ignored.
export function fastestBranch(voltage, band) {
  let [most, begin, end] = [0, 0, 0];
  for (let i = 1; i <= voltage.length; i += 1) {
    const way = Math.sign(voltage[end] - voltage[begin]);
    const back = i < voltage.length ? way * (voltage[end] - voltage[i]) : Infinity;
    if (back > band) {
      most = Math.max(most, meanSpeed(voltage.subarray(begin, end + 1), 0.5 * band));
      [begin, end] = [end, i];
    } else if (back <= 0) end = i;
  }
  return most;
}

// The mean speed of a branch without its time at rest; 0 if its height is not above `least`.
function meanSpeed(branch, least) {
  const height = Math.abs(branch.at(-1) - branch[0]);
  const rest = (0.1 * height) / (branch.length - 1);
  const moving = branch.filter((value, i) => i > 0 && Math.abs(value - branch[i - 1]) > rest).length;
  return height > least ? height / moving : 0;
}

function largestDifference(some, others) {
  let most = 0;
  for (let i = 0; i < some.length; i += 1) most = Math.max(most, Math.abs(some[i] - others[i]));
  return most;
}
