// The pictures of a path of several coupled axes: the wanted displacements, and the voltages that were written last.
import { voltageColumns } from "./api.js";
import { h, make } from "./dom.js";
import { Figure, MICROMETRES, SECONDS, VOLTS } from "./figure.js";
import { curve } from "./path_figures.js";
import { HANDLE_KEYS, PointHandles } from "./point_handles.js";
import { COLOURS } from "./records.js";

// A path of an axis that stays in the middle of its reach while another one moves along points.
export const resting = ({ range_um: [low, high] }, points) =>
  [points[0], points.at(-1)].map(([time]) => [time, (low + high) / 2]);

const curves = (names, x, y) => names.map((name, k) => curve(name, COLOURS[k % COLOURS.length], x(k), y(k)));

export class AxesFigures {
  // `edited` is called with the points (s, um) of the drawn axis after each change by the person.
  constructor(edited) {
    this.path = new Figure({ title: "Displacement", keys: HANDLE_KEYS });
    this.voltage = new Figure({ title: "Voltage written last", help: false });
    this.handles = new PointHandles(this.path.chart, edited);
    this.element = make(h("div.figures.steady", this.path.element, this.voltage.element));
  }

  // Draw `paths`, points for each axis of these `names`, with handles at those that are `drawn`: { points, reach }.
  draw(names, paths, drawn) {
    this.handles.set(drawn?.points ?? [], drawn?.reach ?? [0, 1]);
    const column = (k, at) => Float64Array.from(paths[k], (point) => point[at]);
    const series = curves(names, (k) => column(k, 0), (k) => column(k, 1));
    const { x, y } = this.handles.ranges(series.map((one) => one.y));
    const axes = { x: { ...SECONDS, range: x }, y: { ...MICROMETRES, range: y } };
    this.path.set({ ...axes, series }, { keep: true, spoken: `Wanted displacement of ${names.join(", ")} over time.` });
  }

  // Show a voltage that was written, if there is one.
  async show(names, written) {
    this.voltage.element.hidden = !written;
    if (!written || written.id === this.written) return;
    this.written = written.id;
    const columns = await Promise.all(names.map((name) => voltageColumns(written, name)));
    const series = curves(names, (k) => columns[k].time, (k) => columns[k].voltage);
    if (this.written !== written.id) return;
    this.voltage.set({ x: SECONDS, y: VOLTS, series }, { spoken: `Voltage of ${names.join(", ")} over time.` });
  }
}
