// Two virtual actuators of one kind follow one motion, live: one by a straight scale factor, one by dehyst.
import { Compensator, load } from "./dehyst.js";
import { PlayActuator } from "./play_actuator.js";
import { Plot, short } from "./plot.js";

const RANGE = 16; // um, of the pictures
const KEPT = 6000; // samples of the picture of errors
const EASE = 0.01; // share by which the size follows its slider in a sample
const SHAPES = {
  sine: (phase) => Math.sin(2 * Math.PI * phase),
  triangle: (phase) => 1 - 4 * Math.abs((phase % 1) - 0.5),
  beat: (phase) => Math.sin(2 * Math.PI * phase) * Math.cos((2 * Math.PI * phase) / 7),
  stairs: (phase) => Math.round(4 * (1 - 4 * Math.abs((phase % 1) - 0.5))) / 4,
};

class Side {
  constructor(canvas, number, colour, voltage) {
    this.plot = new Plot(canvas, "wanted (\u00b5m)", "reached (\u00b5m)");
    this.number = number;
    this.colour = colour;
    this.voltage = voltage;
    this.actuator = new PlayActuator();
    this.wanted = [];
    this.reached = [];
  }

  step(wanted) {
    const reached = this.actuator.play(this.voltage(wanted));
    this.wanted.push(1e6 * wanted);
    this.reached.push(1e6 * reached);
    if (this.wanted.length > KEPT) {
      this.wanted.shift();
      this.reached.shift();
    }
  }

  get errors() {
    return this.reached.map((one, i) => one - this.wanted[i]);
  }

  draw(samples) {
    const from = Math.max(0, this.wanted.length - samples);
    const range = [-0.03 * RANGE, 1.03 * RANGE];
    this.plot.draw({
      x: range,
      y: range,
      lines: [
        { x: range, y: range, colour: "line", width: 1, dash: [4, 4] },
        { x: this.wanted.slice(from), y: this.reached.slice(from), colour: this.colour, width: 2 },
      ],
    });
    const largest = this.errors.slice(from).reduce((most, one) => Math.max(most, Math.abs(one)), 0);
    const length = largest < 0.1 ? `${short(1000 * largest)} nm` : `${short(largest)} \u00b5m`;
    this.number.textContent = `${length}, ${short((100 * largest) / RANGE)} %`;
  }
}

class Playground {
  constructor(root, compensator) {
    const find = (name) => root.querySelector(`[name="${name}"]`);
    const canvases = root.querySelectorAll("canvas");
    const numbers = root.querySelectorAll("output");
    const { limits, reach, period } = compensator.about;
    const slope = (limits[1] - limits[0]) / (reach[1] - reach[0]);
    const within = (v) => Math.min(Math.max(v, limits[0]), limits[1]);
    this.period = period;
    this.inputs = { size: find("size"), frequency: find("frequency"), shape: find("shape") };
    this.button = find("run");
    this.sides = [
      new Side(canvases[0], numbers[0], "without", (y) => within(limits[0] + (y - reach[0]) * slope)),
      new Side(canvases[1], numbers[1], "simulated", (y) => compensator.step(y)),
    ];
    this.errors = new Plot(canvases[2], "time (s)", "error (\u00b5m)");
    this.size = Number(this.inputs.size.value);
    this.phase = 0.75;
    this.seconds = 0;
    this.running = !window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.button.addEventListener("click", () => this.run(!this.running));
    for (const input of Object.values(this.inputs)) {
      input.addEventListener("input", () => !this.running && this.play(2 / Number(this.inputs.frequency.value)));
    }
    // So that the first picture has whole loops.
    this.play(2 / Number(this.inputs.frequency.value));
    this.run(this.running);
  }

  run(on) {
    this.running = on;
    this.button.textContent = on ? "Pause" : "Run";
    this.before = null;
    if (on) requestAnimationFrame((now) => this.frame(now));
  }

  frame(now) {
    if (!this.running) return;
    // A page that was hidden does not catch up.
    this.play(Math.min((now - (this.before ?? now)) / 1000, 0.1));
    this.before = now;
    requestAnimationFrame((later) => this.frame(later));
  }

  play(seconds) {
    const frequency = Number(this.inputs.frequency.value);
    const shape = SHAPES[this.inputs.shape.value];
    for (let i = 0; i < Math.round(seconds / this.period); i += 1) {
      this.size += EASE * (Number(this.inputs.size.value) - this.size);
      this.phase += frequency * this.period;
      this.seconds += this.period;
      const share = 0.5 + 0.005 * this.size * shape(this.phase);
      for (const side of this.sides) side.step(1e-6 * RANGE * share);
    }
    this.draw(Math.round(1 / frequency / this.period));
  }

  draw(samples = Math.round(1 / Number(this.inputs.frequency.value) / this.period)) {
    for (const side of this.sides) side.draw(samples);
    const [straight, own] = this.sides.map((side) => side.errors);
    const x = straight.map((_, i) => this.seconds + (i + 1 - straight.length) * this.period);
    this.errors.draw({
      x: [this.seconds - KEPT * this.period, this.seconds],
      y: [-0.15 * RANGE, 0.15 * RANGE],
      levels: [0],
      lines: [
        { x, y: straight, colour: "without" },
        { x, y: own, colour: "simulated", width: 1.8 },
      ],
    });
  }
}

const root = document.getElementById("playground");
if (root) {
  const playground = new Playground(root, new Compensator(await load(MODULE)));
  root.classList.add("ready");
  window.addEventListener("resize", () => playground.draw());
}
