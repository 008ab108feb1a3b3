// Elements of pages. Texts of a record are set as text, never as markup.

const SVG = "http://www.w3.org/2000/svg";

/** Make an element; `text` is its text, and what begins with `on` listens to an event. */
export function h(tag, properties = {}, ...children) {
  return complete(document.createElement(tag), properties, children);
}

/** Make an element of SVG. */
export function s(tag, properties = {}, ...children) {
  return complete(document.createElementNS(SVG, tag), properties, children);
}

function complete(element, properties, children) {
  for (const [name, value] of Object.entries(properties)) {
    if (value === undefined || value === null || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "text") element.textContent = value;
    else if (name === "value" || name === "checked") element[name] = value;
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...present(children));
  return element;
}

export function fill(element, ...children) {
  element.replaceChildren(...present(children));
}

function present(children) {
  return children.filter((child) => child !== null && child !== undefined && child !== false);
}

export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Change between light and dark; without a choice the page follows the system. */
export function changeTheme() {
  const { dataset } = document.documentElement;
  const dark = window.matchMedia("(prefers-color-scheme: dark)").matches;
  dataset.theme = (dataset.theme ?? (dark ? "dark" : "light")) === "dark" ? "light" : "dark";
}
