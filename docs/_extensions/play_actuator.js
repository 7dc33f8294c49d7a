// The virtual actuator of dehyst.virtual.PlayActuator, without noise and creep: play operators of the voltage, summed
// and mapped asymmetrically. It shares nothing with the model that compensates it.
const STROKE = 16.152e-6;
const HIGHEST = 200;
const WIDTH = 0.55;
const ASYMMETRY = 0.1;
const BEND = 0.12;
const PLAYS = 300;

export class PlayActuator {
  // After a long descent to 0 V each play lies at its threshold.
  constructor() {
    this.threshold = Float64Array.from({ length: PLAYS }, (_, i) => (0.5 * HIGHEST * (i + 0.5)) / PLAYS);
    const density = this.threshold.map((r) => Math.exp((-2.5 * r) / (0.5 * HIGHEST)));
    const sum = (values) => values.reduce((total, one, i) => total + one * density[i], 0);
    const scale = WIDTH / sum(this.threshold.map((r) => HIGHEST - 2 * r));
    this.weight = density.map((one) => scale * one);
    this.rest = scale * sum(this.threshold);
    this.output = this.threshold.slice();
  }

  /** Return the displacement [m] under a voltage. */
  play(voltage) {
    const { threshold, weight, output } = this;
    let summed = -this.rest;
    for (let i = 0; i < PLAYS; i += 1) {
      output[i] = Math.min(Math.max(output[i], voltage - threshold[i]), voltage + threshold[i]);
      summed += weight[i] * output[i];
    }
    const w = ((1 - WIDTH) * voltage) / HIGHEST + summed;
    return STROKE * (w + ASYMMETRY * w * (w - 1) + BEND * w * (w - 1) * (w - 0.5));
  }
}
