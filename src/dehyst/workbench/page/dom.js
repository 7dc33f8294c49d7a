// Elements of the page: making them, keeping lists of them, and saying something to a screen reader.

export const byId = (id) => document.getElementById(id);

// h("button", { class: "main", onclick: f, disabled: true }, "Identify"): null and false children are left out.
export function h(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === undefined || value === null || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.flat(2).filter((one) => one !== null && one !== undefined && one !== false));
  return element;
}

// Set the text only if it differs: a live region speaks each change, and a selection in it survives.
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export function show(element, visible) {
  if (element.hidden === visible) element.hidden = !visible;
}

// Keep one child of `parent` an item, in their order: children stay as they are as long as their key and `stamp` do.
export function keyed(parent, items, { key = (item) => item.id, stamp = JSON.stringify, create }) {
  const old = new Map([...parent.children].map((child) => [child.dataset.key, child]));
  let place = parent.firstElementChild;
  for (const item of items) {
    const name = String(key(item));
    const mark = stamp(item);
    let child = old.get(name);
    old.delete(name);
    if (child?.dataset.stamp !== mark) {
      const focused = child?.contains(document.activeElement) ? document.activeElement.dataset.name : undefined;
      const next = create(item);
      next.dataset.key = name;
      next.dataset.stamp = mark;
      if (child) {
        if (place === child) place = next;
        child.replaceWith(next);
      }
      child = next;
      if (focused && child.isConnected) child.querySelector(`[data-name="${focused}"]`)?.focus();
    }
    if (place === child) place = child.nextElementSibling;
    else parent.insertBefore(child, place);
  }
  for (const child of old.values()) child.remove();
}

let fields = 0;

// A labelled control: `control` is an input, select or similar; `unit` stands behind it, `hint` below.
export function field(label, control, { unit, hint } = {}) {
  const id = control.id || `field-${(fields += 1)}`;
  control.id = id;
  const note = hint && h("small", { class: "hint", id: `${id}-hint` }, hint);
  if (note) control.setAttribute("aria-describedby", note.id);
  const head = h("label", { for: id }, label, unit && h("span", { class: "unit" }, ` (${unit})`));
  return h("div", { class: "field" }, head, control, note);
}

export const number = (properties = {}) =>
  h("input", { type: "text", inputmode: "decimal", autocomplete: "off", spellcheck: "false", ...properties });

export function choice(options, chosen, properties = {}) {
  return h(
    "select",
    properties,
    options.map(([value, text]) => h("option", { value, selected: value === chosen }, text)),
  );
}

export function table(caption, heads, rows) {
  return h(
    "div",
    { class: "wide", tabindex: "0", role: "region", "aria-label": caption },
    h(
      "table",
      {},
      h("caption", { class: "unseen" }, caption),
      h("thead", {}, h("tr", {}, heads.map((head) => h("th", { scope: "col", class: head.class }, head.text ?? head)))),
      h("tbody", {}, rows.map((row) => h("tr", {}, row.map(cell)))),
    ),
  );
}

function cell(value, column) {
  if (value instanceof Node && value.tagName === "TD") return value;
  return column === 0 ? h("th", { scope: "row" }, value) : h("td", {}, value);
}

// Run an action of a button: it is disabled meanwhile, and an error appears in `place` in full.
export function action(button, place, work) {
  button.addEventListener("click", async () => {
    button.disabled = true;
    say(place, "");
    try {
      await work();
    } catch (error) {
      say(place, error.message);
    } finally {
      button.disabled = false;
    }
  });
  return button;
}

export const errorPlace = () => h("p", { class: "error", role: "alert" });

// Text for the screen reader alone.
export function announce(text) {
  say(byId("announcer"), text);
}
