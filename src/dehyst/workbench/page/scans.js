// The form of the named scans, with the options that the library declares.
import { DECLARED } from "./declared.js";
import { h } from "./dom.js";
import { Form, fold } from "./forms.js";
import { plain, roundDown } from "./numbers.js";

const FASTEST = 2.11; // largest speed of a triangle or a raster, in its widths a cycle
const SUGGESTED = [0.2, 0.8]; // lowest and highest displacement, as parts of the reachable range
const STEEPEST = 0.5 * 1.875; // largest speed of a change of level, in widths of the scan per duration of the change

export class ScanForm extends Form {
  // Suggest displacements that the model reaches, and speeds of at most `pace` reachable ranges a second.
  suggest([low, high], pace) {
    const place = (share) => plain(low + share * (high - low), 3);
    const [from, to] = SUGGESTED;
    const widths = pace / (to - from);
    Object.assign(this.values, {
      low: place(from),
      high: place(to),
      levels: [from, 0.5, to, 0.5].map(place).join(" "),
      edge: plain(1 / roundDown(Math.min(20, widths / STEEPEST))),
      frequency: plain(roundDown(Math.min(1, widths / FASTEST))),
    });
  }

  view() {
    const { needs, may } = DECLARED.scans[this.values.kind];
    const more = fold("More options", this.row(may));
    return [this.field("kind"), h("div.scan-options", this.row(needs), more)];
  }

  // The options for the server; an Error names an option that is wrong.
  scan() {
    const { needs, may } = DECLARED.scans[this.values.kind];
    return this.collected(["kind", ...needs, ...may], needs);
  }
}
