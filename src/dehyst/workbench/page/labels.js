// What the fields of this page are called, and sentences of dehyst in these words.
export const LABELS = {
  time: "Column of the time",
  voltage: "Column of the voltage",
  displacement: "Column of the displacement",
  voltage_scale: "Scale of the voltage",
  displacement_scale: "Scale of the displacement",
  sample_rate: "Sample rate in Hz",
  decimal: "Decimal sign",
  structure: "Structure",
  goal: "Goal: largest error",
  time_limit: "Time limit",
  sensor_lag: "Lag of the sensor",
  norm: "Norm of the error",
};

// An option as a command has it (--sensor-lag SECONDS) or as a function has it (sensor_lag=SECONDS, time "NAME").
const FLAGS = Object.entries(LABELS).map(([name, label]) => [
  new RegExp(
    `(--${name.replace("_", "-")}(?![-\\w])[ =]?|\\b${name}${name.includes("_") ? "\\b=?" : '(?:=| (?="))'})` +
      '("NAME"|NAMES?\\b|HZ\\b|SCALE\\b|SECONDS\\b)?(?=(.?))',
    "g",
  ),
  (found, flag, value, next) =>
    `\u201c${label}\u201d${value || !/[ =]$/.test(flag) || "),".includes(next) ? "" : " "}`,
]);
export const inPage = (sentence) => FLAGS.reduce((text, [flag, label]) => text.replace(flag, label), sentence);
