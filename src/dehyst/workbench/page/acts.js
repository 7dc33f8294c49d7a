// Buttons that act, what went wrong, and words for those who do not see the page.
import { remove } from "./api.js";
import { byId, h } from "./dom.js";
import { redraw } from "./state.js";

// What went wrong, by the place where it is shown; and the buttons whose work goes on.
const problems = new Map();
const busy = new Set();

export const problem = (place) =>
  problems.get(place) && h("p.error", { role: "alert", key: `problem ${place}` }, problems.get(place));

export function complain(place, sentence) {
  if ((problems.get(place) ?? "") === sentence) return;
  problems.set(place, sentence);
  redraw();
}

// A button that works: it is disabled meanwhile, and an error is shown in full in its place.
export function button(text, place, work, properties = {}) {
  const key = `${place} ${text}`;
  const onclick = async () => {
    busy.add(key);
    complain(place, "");
    redraw();
    try {
      await work();
    } catch (error) {
      complain(place, error.message);
    }
    busy.delete(key);
    redraw();
  };
  return h("button", { type: "button", disabled: busy.has(key), onclick, ...properties }, text);
}

// Takes a record or a model ("records", "models") from the list; an error stands in the place `KIND ID`.
export const removeButton = (kind, { id, name }) =>
  button("Remove", `${kind} ${id}`, () => remove(kind, id), {
    class: "quiet",
    "aria-label": `Remove ${name} from the list`,
  });

// Text for the screen reader alone.
export function announce(text) {
  byId("announcer").textContent = text;
}
