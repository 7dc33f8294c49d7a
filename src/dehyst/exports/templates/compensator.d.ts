// dehyst: types of a compensator in WebAssembly.

/** What a module says about its model. */
export interface About {
  format: "dehyst-wasm";
  version: string;
  name: string;
  /** Lowest and highest voltage [V]. */
  limits: [number, number];
  /** Largest rate of the voltage [V/s]; null: any. */
  slewRate: number | null;
  /** Seconds between steps; null: this model does not depend on time. */
  period: number | null;
  /** Whether the numbers hold for this period only: creep, inertia, a lag or a preview. */
  needsPeriod: boolean;
  /** A displacement is to be given so many samples before its time. */
  samplesAhead: number;
  /** Displacements at both limits [m]. */
  reach: [number, number];
  /** Where memory begins: displacement [m], voltage [V] and the way to bring the actuator there. */
  start: { displacement: number; voltage: number; way: string };
  /** Only of a model that depends on temperature: 1/K, m/K, degC. */
  thermal?: { gain: number; offset: number; reference: number };
}

export interface Options {
  /** Lowest and highest voltage [V]; default: those of the export. */
  limits?: [number, number];
  /** Largest rate of the voltage [V/s], null for any; default: that of the export. */
  slewRate?: number | null;
  /** Seconds between steps; another one than that of the export only if `needsPeriod` is false. */
  period?: number | null;
}

export interface Trajectory {
  /** [V], within the limits. */
  voltage: Float64Array;
  /** Displacement of the actuator [m] under these voltages. */
  displacement: Float64Array;
  /** 0: as wanted, 1: clamped by a limit, 2: slewed. */
  clamped: Uint8Array;
}

export interface Clamps {
  limited: number;
  slewed: number;
  refused: number;
}

/** Compile a module from bytes, a Response, a URL or a file name; by default the .wasm file beside this one. */
export function load(source?: BufferSource | Response | URL | string): Promise<WebAssembly.Module>;

/**
 * A compensator and its memory. Only trajectory and simulate leave the memory as it is. Numbers that are not finite
 * raise a RangeError, and nothing moves.
 */
export class Compensator {
  readonly about: About;
  readonly limits: [number, number];
  readonly slewRate: number | null;
  readonly period: number | null;
  /** The last voltage [V]. */
  readonly voltage: number;
  /** Displacement of the actuator after all voltages [m]. */
  readonly displacement: number;
  /** Numbers of samples that were clamped, slewed, or refused. */
  readonly clamps: Clamps;
  /** Gain and offset [m] of the displacement; 1 and 0 after a reset. */
  readonly scaling: { gain: number; offset: number };

  constructor(module: WebAssembly.Module, options?: Options);
  /** Begin again from the model's start; counts restart at 0. */
  reset(): void;
  /** Set gain and offset [m] of the displacement between two steps, for another temperature or an aged actuator. */
  scale(gain: number, offset?: number): void;
  /** Set gain and offset for a temperature [degC] between two steps; needs a model that depends on it. */
  setTemperature(degrees: number): void;
  /**
   * Begin to feed back a sensor in `track`, without a correction. `gain`: share of the error that a reading takes away, as
   * `Feedback.gain` in Python. `bound`: largest correction, and the farthest that a reading may be from the model [m].
   * `late`: periods by which a reading is late.
   */
  feedback(gain: number, bound: number, late?: number): void;
  /** Step with an integral of the error; a `measured` displacement [m] that is NaN or missing holds the correction. */
  track(displacement: number, measured?: number): number;
  /** Why the sensor is not believed: 0 it is, 1 far from the model, 2 stuck, 3 scaled, 4 it contradicts the model. */
  readonly fault: 0 | 1 | 2 | 3 | 4;
  /** Return the voltage [V] to send for a displacement [m], which then counts as sent. */
  step(displacement: number): number;
  /** Return the voltage [V] for a displacement [m]; nothing moves until a voltage is committed. */
  offer(displacement: number): number;
  /** End a period with the voltage [V] that was really sent, by default the last one. */
  commit(voltage?: number): void;
  /** The actuator alone: return its displacement [m] after a period with any voltage [V]. */
  play(voltage: number): number;
  /** Return the voltages [V] of many steps, displacements in [m]. */
  run(displacements: Float64Array | readonly number[]): Float64Array;
  /** Move towards a displacement [m] until a step within the slew rate leads to it; return the number of steps. */
  lead(displacement: number): number;
  /** Return the voltages of a whole path [m], within the slew rate from the present one on. The memory stays. */
  trajectory(displacements: Float64Array | readonly number[]): Trajectory;
  /** Return the displacements [m] of the actuator alone under voltages [V]. The memory stays. */
  simulate(voltages: Float64Array | readonly number[]): Float64Array;
}
