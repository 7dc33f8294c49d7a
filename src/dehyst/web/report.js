// Draws charts from the numbers inside a page.
import { h, showCode } from "./dom.js";
import { Figure } from "./figure.js";

const COLUMNS = ["x", "y", "top", "values"];

// Decode a column: 16-bit steps above its lowest value, with one code for a missing value.
export function column(stored) {
  const bytes = Uint8Array.from(atob(stored.steps), (letter) => letter.charCodeAt(0)).buffer;
  const values = (code) => (code === 65535 ? NaN : stored.low + stored.step * code);
  return Float64Array.from(new Uint16Array(bytes), values);
}

export function drawCharts(root, { columns, charts }) {
  const decoded = columns.map(column);
  for (const place of root.querySelectorAll("[data-chart]")) {
    const { title, role, label, ...spec } = charts[place.dataset.chart];
    const figure = new Figure({ title, label, more: role && h("span.role", role) });
    const decode = (series) => COLUMNS.filter((name) => name in series).map((name) => [name, decoded[series[name]]]);
    spec.series = spec.series.map((series) => ({ ...series, ...Object.fromEntries(decode(series)) }));
    place.replaceChildren(figure.element);
    figure.set(spec);
  }
}

// The sections of a report, for another page, without title and script.
export function reportParts(text) {
  // The policy of this page may forbid styles in text: they are set by the script below.
  const plain = text.replace(/<style>.*?<\/style>/s, "").replaceAll(' style="', ' data-style="');
  const page = new DOMParser().parseFromString(plain, "text/html");
  const charts = page.getElementById("chart-data");
  const element = document.createElement("div");
  element.className = "report";
  element.append(...page.querySelector("main").children);
  for (const part of element.querySelectorAll("h1, .command")) part.remove();
  for (const styled of element.querySelectorAll("[data-style]")) styled.style.cssText = styled.dataset.style;
  for (const pre of element.querySelectorAll("pre")) showCode(pre, pre.textContent);
  if (charts) drawCharts(element, JSON.parse(charts.textContent));
  return element;
}

const stored = document.getElementById("chart-data");
// Those of this page, if it is a report.
if (stored) drawCharts(document, JSON.parse(stored.textContent));
