// dehyst: a compensator in WebAssembly. Wanted displacement [m] in, voltage [V] out, one step a period; the bits are
// those of Python. For browsers and node.
//
//     import { Compensator, load } from "./model.js";
//     const compensator = new Compensator(await load());
//     const voltage = compensator.step(12e-6);

const MOST = 1e6; // steps on the way to a displacement

/** Compile a module from bytes, a Response, a URL or a file name; by default the .wasm file beside this one. */
export async function load(source = new URL(import.meta.url.replace(/\.js(?=[?#]|$)/, ".wasm"))) {
  const named = typeof source === "string" || source instanceof URL;
  if (named && globalThis.process?.versions?.node && !/^(https?|data|blob):/.test(source)) {
    source = await (await import("node:fs/promises")).readFile(source);
  } else if (named) {
    source = await fetch(source);
  }
  if (!(source instanceof Response)) return WebAssembly.compile(source);
  if (!source.ok) throw new Error(`${source.url}: ${source.status} ${source.statusText}`);
  return WebAssembly.compile(await source.arrayBuffer());
}

function section(module, name) {
  const found = WebAssembly.Module.customSections(module, name);
  if (found.length !== 1) throw new TypeError(`the module has ${found.length} sections ${name}; export it by dehyst`);
  return new Uint8Array(found[0]);
}

function demand(core, status) {
  if (status === 0) return;
  const words = new Uint8Array(core.memory.buffer, core.words(status));
  throw new RangeError(`the model is refused: ${String.fromCharCode(...words.subarray(0, words.indexOf(0)))}`);
}

function number(result, given) {
  if (Number.isNaN(result)) throw new RangeError(`got ${given}, need a finite number that the model can follow`);
  return result;
}

/** A compensator and its memory. Only trajectory and simulate leave the memory as it is. */
export class Compensator {
  #core;
  #views;
  #memory;
  #feeds;

  constructor(module, { limits, slewRate, period } = {}) {
    const numbers = section(module, "dehyst.model");
    this.about = JSON.parse(new TextDecoder().decode(section(module, "dehyst.about")));
    const core = (this.#core = new WebAssembly.Instance(module).exports);
    const place = core.reserve(numbers.length);
    if (place === 0) throw new RangeError("the model is refused: it is too large");
    new Uint8Array(core.memory.buffer, place, numbers.length).set(numbers);
    demand(core, core.open());
    this.#limit(limits, slewRate, period);
    this.reset();
    const reals = (at) => new Float64Array(core.memory.buffer, at, core.block());
    this.#views = {
      inputs: reals(core.inputs()),
      voltage: reals(core.voltages()),
      displacement: reals(core.displacements()),
      clamped: new Uint8Array(core.memory.buffer, core.offers(), core.block()),
    };
    this.#memory = new Uint8Array(core.memory.buffer, core.state_begin(), core.state_end() - core.state_begin());
  }

  #limit(limits = this.about.limits, slewRate = this.about.slewRate, period = this.about.period) {
    if (this.about.needsPeriod && period !== this.about.period) {
      throw new RangeError(`period: got ${period}, but these numbers are for ${this.about.period} s; export again`);
    }
    if (slewRate !== null && period === null) throw new RangeError("slewRate: needs a period too");
    const [low, high] = limits;
    demand(this.#core, this.#core.limit(low, high, slewRate === null ? Number.MAX_VALUE : slewRate * period));
    Object.assign(this, { limits: [low, high], slewRate, period });
  }

  /** Begin again from the model's start; counts restart at 0. */
  reset() {
    demand(this.#core, this.#core.begin());
    this.#feeds = false;
  }

  /** Set gain and offset of the displacement between two steps. */
  scale(gain, offset = 0) {
    if (this.#core.scale(gain, offset)) throw new RangeError(`gain: got ${gain}, offset ${offset}`);
  }

  /** Set gain and offset for a temperature [degC] between two steps; needs a model that depends on it. */
  setTemperature(degrees) {
    const { thermal } = this.about;
    if (!thermal) throw new RangeError("temperature: this model does not depend on it");
    const kelvins = degrees - thermal.reference;
    this.scale(1 + thermal.gain * kelvins, thermal.offset * kelvins);
  }

  /** Begin to feed back a sensor in `track`: share of the error [0 to 1] and largest correction [m]. */
  feedback(gain, bound, late = this.about.samplesAhead ?? 0) {
    if (this.#core.feedback(gain, bound, late)) throw new RangeError(`gain, bound, late: got ${[gain, bound, late]}`);
    this.#feeds = true;
  }

  /** Why the sensor is not believed: 0 it is, 1 far from the model, 2 stuck, 3 scaled, 4 contradicts it. */
  get fault() {
    return this.#feeds ? this.#core.fault() : 0;
  }

  /** Step with an integral of the error; without a number `measured`, the correction is held. */
  track(displacement, measured = NaN) {
    if (!this.#feeds) throw new RangeError("feedback: call it first");
    const before = this.#memory.slice();
    const voltage = this.#core.step(displacement + this.#core.correct(measured));
    if (Number.isNaN(voltage)) this.#memory.set(before);
    return number(voltage, displacement);
  }

  /** Return the voltage to send for a displacement, which then counts as sent. */
  step(displacement) {
    return number(this.#core.step(displacement), displacement);
  }

  /** Return the voltage for a displacement; nothing moves until a voltage is committed. */
  offer(displacement) {
    return number(this.#core.offer(displacement), displacement);
  }

  /** End a period with the voltage that was really sent, by default the last one. */
  commit(voltage = this.voltage) {
    this.#core.commit(this.#core.accepts(voltage) ? voltage : number(NaN, `${voltage} V`));
  }

  /** The actuator alone: return its displacement after a period with any voltage. */
  play(voltage) {
    return number(this.#core.play(voltage), voltage);
  }

  /** Return the voltages of many steps. */
  run(displacements) {
    return this.#path("run", displacements, false).voltage;
  }

  /** Move towards a displacement until a step within the slew rate leads to it; return the number of steps. */
  lead(displacement) {
    const change = this.slewRate === null ? Infinity : this.slewRate * this.period * (1 - 1e-9);
    for (let steps = 0; steps <= MOST; steps += 1) {
      const voltage = this.offer(displacement);
      if (Math.abs(voltage - this.voltage) < change) return steps;
      this.commit(voltage);
    }
    throw new RangeError(`slewRate: ${this.slewRate} V/s leads there in more than ${MOST} steps; give more`);
  }

  /** Return voltage, displacement and clamped of a whole path, within the slew rate from the present voltage on. */
  trajectory(displacements) {
    return this.#path("run", displacements, true);
  }

  /** Return the displacements of the actuator alone under voltages. */
  simulate(voltages) {
    return this.#path("simulate", voltages, true).displacement;
  }

  /** Gain and offset [m] of the displacement. */
  get scaling() {
    return { gain: this.#core.gain(), offset: this.#core.offset() };
  }

  /** The last voltage [V]. */
  get voltage() {
    return this.#core.sent();
  }

  /** Displacement of the actuator after all voltages [m]. */
  get displacement() {
    return this.#core.displacement();
  }

  /** Numbers of samples that were clamped, slewed, or refused. */
  get clamps() {
    const { limited, slewed, refused } = this.#core;
    return { limited: limited() >>> 0, slewed: slewed() >>> 0, refused: refused() >>> 0 };
  }

  #path(call, values, keep) {
    const { inputs, ...outputs } = this.#views;
    const before = this.#memory.slice();
    const refused = this.clamps.refused;
    const result = {};
    for (const name in outputs) result[name] = new outputs[name].constructor(values.length);
    for (let at = 0; at < values.length; at += inputs.length) {
      const n = Math.min(inputs.length, values.length - at);
      inputs.set(values.slice(at, at + n));
      this.#core[call](n);
      for (const name in outputs) result[name].set(outputs[name].subarray(0, n), at);
    }
    const followed = this.clamps.refused === refused;
    if (keep || !followed) this.#memory.set(before);
    return followed ? result : number(NaN, "a sample of the path that is not a number, or too large");
  }
}
