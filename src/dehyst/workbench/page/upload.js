// Files on their way to the server: dropped anywhere on the page, or chosen.
import { getBuffer, upload } from "./api.js";
import { announce, byId, h, say, show } from "./dom.js";
import { bytes, percent } from "./numbers.js";
import { openStep } from "./steps.js";
import { session } from "./state.js";

let depth = 0;
let sending = 0;
export const isSending = () => sending > 0;

export function bindDrops() {
  const cover = byId("drop-cover");
  const holdsFiles = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");
  window.addEventListener("dragenter", (event) => {
    if (!holdsFiles(event)) return;
    depth += 1;
    show(cover, true);
  });
  window.addEventListener("dragleave", (event) => {
    if (!holdsFiles(event)) return;
    depth = Math.max(0, depth - 1);
    if (depth === 0) show(cover, false);
  });
  window.addEventListener("dragover", (event) => event.preventDefault());
  window.addEventListener("drop", (event) => {
    event.preventDefault();
    depth = 0;
    show(cover, false);
    if (holdsFiles(event)) sendAll(event.dataTransfer.files);
  });
}

export async function sendExample() {
  send(new File([await getBuffer("/page/example.csv")], "example.csv"));
}

export function sendAll(files) {
  openStep("records");
  for (const file of files) send(file);
}

async function send(file) {
  const bar = h("progress", { max: "1", value: "0", "aria-label": `Upload of ${file.name}` });
  const words = h("span", {}, `${file.name}, ${bytes(file.size)}: sending`);
  const row = h("li", {}, words, bar);
  byId("uploads").append(row);
  const limit = session.state.upload_limit;
  sending += 1;
  try {
    if (limit && file.size > limit) throw new Error(`it has ${bytes(file.size)}, and at most ${bytes(limit)} can be read`);
    await upload(`/api/records?name=${encodeURIComponent(file.name)}`, file, (share) => {
      bar.value = share;
      say(words, `${file.name}, ${bytes(file.size)}: ${percent(100 * share)} sent`);
    });
    row.remove();
    announce(`${file.name} was sent and is being read.`);
  } catch (error) {
    refused(row, file, error.message);
  } finally {
    sending -= 1;
  }
}

function refused(row, file, sentence) {
  const close = h("button", { type: "button", class: "quiet", onclick: () => row.remove() }, "Dismiss");
  row.replaceChildren(h("p", { class: "error", role: "alert" }, `${file.name} was not sent: ${sentence}`), close);
}
