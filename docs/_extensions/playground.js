// Two virtual actuators of one kind follow one motion, live: one by a straight scale factor, one by dehyst.
import { Chart } from "./chart.js";
import { Compensator, load } from "./dehyst.js";
import { length, short } from "./numbers.js";

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
  constructor(holder, number, colour, voltage) {
    this.chart = new Chart(holder, { label: holder.dataset.label });
    Object.assign(this, { number, colour, voltage, actuator: new PlayActuator(), wanted: [], reached: [] });
  }

  step(wanted) {
    this.wanted.push(1e6 * wanted);
    this.reached.push(1e6 * this.actuator.play(this.voltage(wanted)));
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
    const [x, y] = [this.wanted.slice(from), this.reached.slice(from)];
    this.chart.set({
      x: { label: "wanted (\u00b5m)", unit: "\u00b5m", range },
      y: { label: "reached (\u00b5m)", unit: "\u00b5m", range },
      series: [
        { colour: "line", x: range, y: range, width: 1, dash: [4, 4], silent: true },
        { colour: this.colour, x, y, width: 2 },
      ],
    });
    const largest = this.errors.slice(from).reduce((most, one) => Math.max(most, Math.abs(one)), 0);
    this.number.textContent = `${length(largest)}, ${short((100 * largest) / RANGE)} %`;
  }
}

class Playground {
  constructor(root, compensator) {
    const find = (name) => root.querySelector(`[name="${name}"]`);
    const holders = root.querySelectorAll(".chart");
    const numbers = root.querySelectorAll("output");
    const { limits, reach, period } = compensator.about;
    const slope = (limits[1] - limits[0]) / (reach[1] - reach[0]);
    const within = (v) => Math.min(Math.max(v, limits[0]), limits[1]);
    this.period = period;
    this.inputs = { size: find("size"), frequency: find("frequency"), shape: find("shape") };
    this.button = find("run");
    this.sides = [
      new Side(holders[0], numbers[0], "without", (y) => within(limits[0] + (y - reach[0]) * slope)),
      new Side(holders[1], numbers[1], "simulated", (y) => compensator.step(y)),
    ];
    this.errors = new Chart(holders[2], { label: holders[2].dataset.label });
    this.size = Number(this.inputs.size.value);
    this.phase = 0.75;
    this.seconds = 0;
    this.button.addEventListener("click", () => this.run(!this.running));
    for (const input of Object.values(this.inputs)) {
      input.addEventListener("input", () => !this.running && this.play(2 / this.frequency));
    }
    // So that the first picture has whole loops.
    this.play(2 / this.frequency);
    this.run(!window.matchMedia("(prefers-reduced-motion: reduce)").matches);
  }

  get frequency() {
    return Number(this.inputs.frequency.value);
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
    const shape = SHAPES[this.inputs.shape.value];
    for (let i = 0; i < Math.round(seconds / this.period); i += 1) {
      this.size += EASE * (Number(this.inputs.size.value) - this.size);
      this.phase += this.frequency * this.period;
      this.seconds += this.period;
      const share = 0.5 + 0.005 * this.size * shape(this.phase);
      for (const side of this.sides) side.step(1e-6 * RANGE * share);
    }
    this.draw();
  }

  draw() {
    for (const side of this.sides) side.draw(Math.round(1 / this.frequency / this.period));
    const [straight, own] = this.sides.map((side) => side.errors);
    const x = straight.map((_, i) => this.seconds + (i + 1 - straight.length) * this.period);
    this.errors.set({
      x: { label: "time (s)", unit: "s", range: [this.seconds - KEPT * this.period, this.seconds] },
      y: { label: "error (\u00b5m)", unit: "\u00b5m", range: [-0.15 * RANGE, 0.15 * RANGE] },
      levels: [{ value: 0, colour: "line" }],
      series: [
        { colour: "without", x, y: straight, rising: true },
        { colour: "simulated", x, y: own, rising: true, width: 1.8 },
      ],
    });
  }
}

const playground = document.getElementById("playground");
if (playground) {
  new Playground(playground, new Compensator(await load(MODULE)));
  playground.classList.add("ready");
}
