// The picture of the records: loops, or voltage and displacement over time.
import { getColumns } from "./api.js";
import { Figure } from "./figure.js";
import { whole } from "./numbers.js";
import { colourOf } from "./records.js";
import { isOpen } from "./steps.js";

const VOLTS = { label: "Voltage (V)", unit: "V" };
const MICROMETRES = { label: "Displacement (\u00b5m)", unit: "\u00b5m" };
const SECONDS = { label: "Time (s)", unit: "s" };

// How each view takes its axes from the columns time, voltage and displacement.
const VIEWS = {
  loops: { x: VOLTS, y: MICROMETRES, take: ([, voltage, displacement]) => ({ x: voltage, y: displacement }) },
  time: { x: SECONDS, y: MICROMETRES, take: ([time, , displacement]) => ({ x: time, y: displacement, rising: true }) },
  voltage: { x: SECONDS, y: VOLTS, take: ([time, voltage]) => ({ x: time, y: voltage, rising: true }) },
};

export const versionOf = (record) => `${JSON.stringify(record.options)} ${record.samples}`;

export class RecordFigure {
  constructor() {
    this.figure = new Figure({
      title: "What was measured",
      views: [
        ["loops", "Loops"],
        ["time", "Displacement over time"],
        ["voltage", "Voltage over time"],
      ],
      choose: () => this.draw(this.records, true),
      tall: true,
    });
    this.element = this.figure.element;
    this.records = [];
  }

  // Draw these records, if they are not drawn already and someone can see them.
  async draw(records, again = false) {
    this.records = records;
    const stamp = `${this.figure.view} ${records.map((one) => `${one.id}:${versionOf(one)}`).join(" ")}`;
    if ((!again && stamp === this.stamp) || !isOpen("records")) return;
    this.stamp = stamp;
    const view = VIEWS[this.figure.view];
    let data;
    try {
      data = await Promise.all(records.map((one) => getColumns(`/api/records/${one.id}/data`, 3, versionOf(one))));
    } catch (error) {
      this.stamp = null;
      this.figure.output.textContent = error.message;
      return;
    }
    if (this.stamp !== stamp) return;
    this.figure.set({
      x: view.x,
      y: view.y,
      series: records.map((one, k) => ({ key: one.id, name: one.name, colour: colourOf(one.id), ...view.take(data[k]) })),
    });
    this.figure.describe(`${view.y.label} over ${view.x.label.toLowerCase()} of ${records.map((one) => `${one.name}, ${whole(one.samples)} samples`).join("; ")}.`);
  }
}
