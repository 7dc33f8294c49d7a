// The file of the excitation to play and record.
import { DECLARED } from "./declared.js";
import { h } from "./dom.js";
import { Figure, SECONDS, VOLTS } from "./figure.js";
import { Form, card, facts, fold, list } from "./forms.js";
import { duration, limitsFrom, range, whole } from "./numbers.js";
import * as server from "./server.js";
import { fileLink, jobCards } from "./verdict.js";

const form = new Form("excite", DECLARED.forms.excite);
let filled; // the excitation whose values are in the form
const figure = new Figure({ title: "Voltage to play" });

async function write() {
  const [low, high] = limitsFrom(form.values.low, form.values.high);
  await server.excite({ low, high, slew: form.value("slew"), frequency: form.value("frequency") });
}

// The voltages of the last excitation, which the form shows again, and the slew rate.
export function given({ excitations }) {
  const last = excitations.at(-1);
  if (last && filled !== last.id) form.fill(last.asked);
  filled = last?.id;
  return last ? form.values : { slew: form.values.slew };
}

// The card is open while there is no record; later it is a fold.
export function exciteCard(state) {
  given(state);
  const { excitations, records } = state;
  const last = excitations.at(-1);
  const content = [
    h("p", "One run shows all that is needed: begin to record time, voltage and displacement before you play it."),
    form.row(Object.keys(form.fields)),
    server.button("Write the excitation", "excite", write, { class: last ? "" : "main" }),
    server.problem("excite"),
    h("ul.cards", jobCards(server.openJobs("excite"))),
    [...excitations].reverse().map(written),
    last && records.length === 0 && drawn(last),
  ];
  const about = { id: "excite", key: "excite" };
  return records.length === 0 ? card("What to play", about, content) : h("div.card", about, fold("What to play", content));
}

const written = ({ id, name, file, samples, seconds, range_v: ends, words, asked }) =>
  h("div", { key: id },
    h("p.row",
      h("span", h("b", duration(seconds)), `, ${range(ends, "V")}, ${whole(samples)} samples`),
      fileLink(file, "Download CSV", { class: "button main", "aria-label": `Download ${name}` }),
      server.removeButton("excitations", { id, name }),
    ),
    server.problem(`excitations ${id}`),
    facts([...form.rows(asked), ["In the folder", file]]),
    list(words, "remarks"),
  );

let shown; // the excitation that is drawn
function drawn({ id, file }) {
  if (shown !== id) {
    shown = id;
    server.textOfFile(file).then((text) => {
      const rows = text.trim().split("\n").slice(1).map((row) => row.split(",").map(Number));
      const [x, y] = [0, 1].map((column) => Float32Array.from(rows, (row) => row[column]));
      const series = [{ name: "voltage", colour: "simulated", x, y, rising: true }];
      figure.set({ x: SECONDS, y: VOLTS, series }, { spoken: "Voltage of the excitation over time." });
    }, (error) => server.complain("excite", error.message));
  }
  return figure.element;
}
