// Tables, numbers, addresses and requests, which the pages share.
import { changeTheme, fill, h, setText } from './elements.js';

export * from './elements.js';

const TOKEN = 'zswarm.token';
const THEME = 'zswarm.theme';
const MOST_ROWS = 1000;

// ---- elements

// Make a table; a cell is a text, an element, or [text, class]. Heads are texts, or [text, class].
export function table(heads, rows) {
  const head = heads.map((one) => [one].flat()).map(([text, kind]) => colHead(kind, text));
  return h('div', { class: 'scroll' }, h('table', {},
    h('thead', {}, tr(...head)), h('tbody', {}, ...rows.map((row) => tr(...row)))));
}

export function tr(...cells) {
  return h('tr', {}, ...cells.map((cell) => {
    if (cell instanceof Node) return /^T[HD]$/.test(cell.tagName) ? cell : h('td', {}, cell);
    const [text, kind] = [cell].flat();
    return h('td', { class: kind, text });
  }));
}

// A table that is sorted by its columns and filtered by words. Each row has an id.
export class SortedTable {
  // heads: [text, key or '', class]; order: [key, 1 or -1]; make(row): its element; empty: a text
  constructor(name, heads, order, make, empty) {
    Object.assign(this, { order, make, empty, rows: [], found: [], made: new WeakMap(), body: h('tbody') });
    this.count = h('p', { class: 'dim small' });
    this.filter = h('input', {
      type: 'search', placeholder: 'filter', 'aria-label': `Filter ${name}`,
      oninput: () => this.show(this.rows),
    });
    const head = heads.map(([text, key, kind]) => (
      colHead(kind, key ? button(text, () => this.sort(key)) : text)));
    this.element = h('div', { class: 'scroll tall' },
      h('table', { id: name }, h('thead', {}, tr(...head)), this.body));
  }

  sort(key) {
    const [last, direction] = this.order;
    const first = this.rows.some((row) => typeof row[key] === 'string') ? 1 : -1;
    this.order = [key, key === last ? -direction : first];
    this.show(this.rows);
  }

  // Show rows that pass the filter; a row that is the same object is not made again.
  show(rows) {
    this.rows = rows;
    const [key, direction] = this.order, words = this.filter.value.toLowerCase();
    const found = rows.filter((row) => Object.values(row).flat().some((value) => (
      typeof value === 'string' && value.toLowerCase().includes(words))));
    this.found = found;
    found.sort((a, b) => compare(a[key], b[key], direction) || compare(a.id, b.id, 1));
    const shown = found.slice(0, MOST_ROWS).map((row) => {
      if (!this.made.has(row)) this.made.set(row, this.make(row));
      return this.made.get(row);
    });
    const now = this.body.children;
    if (now.length !== shown.length || shown.some((element, i) => element !== now[i])) {
      fill(this.body, ...shown);
    }
    setText(this.count, rows.length ? `${found.length} of ${rows.length}` : this.empty);
  }
}

function missing(value) {
  return value === null || value === undefined;
}

// Numbers before nothing, texts in natural order.
function compare(a, b, direction) {
  if (missing(a) || missing(b)) return missing(a) - missing(b);
  if (typeof a !== 'string') return direction * (a - b);
  return direction * a.localeCompare(b, 'en', { numeric: true });
}

function colHead(kind, content) {
  return h('th', { scope: 'col', class: kind }, content);
}

export function rowHead(text) {
  return h('th', { scope: 'row', text });
}

// Make a cell with a number.
export function n(value, digits) {
  return [number(value, digits), 'n'];
}

export function button(text, onclick, properties = {}) {
  return h('button', { type: 'button', text, onclick, ...properties });
}

export function section(...children) {
  return h('section', { class: 'card' }, ...children);
}

export function card(title, ...children) {
  return section(h('h2', { text: title }), ...children);
}

export function row(...children) {
  return h('div', { class: 'row' }, ...children);
}

// Make a row whose children stand at both ends.
export function between(...children) {
  return h('div', { class: 'row between' }, ...children);
}

// Make two columns, or one where the page is narrow.
export function two(...children) {
  return h('div', { class: 'two' }, ...children);
}

export function note(text, kind = 'note') {
  return h('p', { class: kind, text });
}

export function copyButton(label, text) {
  const made = button(label, async () => {
    try {
      await navigator.clipboard.writeText(text);
    } catch { // browsers have no clipboard on pages that come by http from another machine
      const area = h('textarea', { value: text, class: 'offscreen' });
      document.body.append(area);
      area.select();
      document.execCommand('copy');
      area.remove();
    }
    made.textContent = 'copied';
    setTimeout(() => { made.textContent = label; }, 1500);
  });
  return made;
}

export function choice(label, options, chosen, onchange) {
  return h('fieldset', { class: 'choice' }, h('legend', { text: label }),
    ...options.map(([value, text]) => h('label', {},
      h('input', {
        type: 'radio', name: label, value, checked: value === chosen,
        onchange: () => onchange(value),
      }),
      h('span', { text }))));
}

export function showError(text) {
  fill(document.getElementById('view'), h('section', { class: 'card', role: 'alert' },
    h('h1', { text: 'This cannot be shown' }), h('p', { text }),
    h('p', {}, h('a', { href: '/', text: 'All runs' }))));
}

// The sign of a state, since some users do not see its colour.
const SIGNS = {
  running: '▶', paused: '❚❚', stopping: '◼', stopped: '◻', finished: '✓', unreadable: '✕',
};
export function badge(status) {
  return h('span', { class: `badge ${status}`, text: `${SIGNS[status] ?? '…'} ${status}` });
}

// ---- numbers

export function number(value, digits = 5) {
  if (missing(value) || Number.isNaN(value)) return '–';
  if (Number.isInteger(value) && Math.abs(value) < 1e7) return value.toLocaleString('en');
  const rounded = Number(value.toPrecision(digits)), size = Math.abs(rounded);
  return size >= 1e7 || (size > 0 && size < 1e-4) ? rounded.toExponential(2) : String(rounded);
}

// Return what the fitness of a run is where candidates have several trials.
export function unitOf(trials) {
  return trials > 1 ? `mean of ${number(trials)} trials` : '';
}

export function duration(seconds) {
  if (!Number.isFinite(seconds)) return '–';
  const s = Math.max(0, seconds);
  if (s < 1) return `${Math.round(s * 1000)} ms`;
  if (s < 120) return `${s < 10 ? s.toFixed(1) : Math.round(s)} s`;
  if (s < 7200) return `${Math.round(s / 60)} min`;
  if (s < 172800) return `${(s / 3600).toFixed(1)} h`;
  return `${(s / 86400).toFixed(1)} d`;
}

export function clock(at) {
  if (!at) return '–';
  const then = new Date(at * 1000);
  const today = then.toDateString() === new Date().toDateString();
  return `${today ? '' : `${then.toLocaleDateString('en-CA')} `}${then.toLocaleTimeString('en-GB')}`;
}

// Make a text such as "5 s ago", which is updated.
export function ago(at) {
  return h('time', { 'data-at': at || null, text: age(at) });
}

function age(at) {
  return at ? `${duration(Date.now() / 1000 - at)} ago` : '–';
}

setInterval(() => {
  for (const one of document.querySelectorAll('time[data-at]')) {
    one.textContent = age(Number(one.dataset.at));
  }
}, 2000);

// ---- addresses

export const query = new URLSearchParams(location.search);
export const run = query.get('run') ?? '';

export const TAKES_TOKEN = 'takes the token: open the address that the dashboard printed';

export function address(page, values = {}) {
  return `${page}?${new URLSearchParams({ run, ...values })}`;
}

export function api(name, values = {}, id = run) {
  const given = new URLSearchParams(values).toString();
  return `/api/runs/${encodeURIComponent(id)}/${name}${given ? `?${given}` : ''}`;
}

export function keepToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get('token');
  if (given) {
    sessionStorage.setItem(TOKEN, given);
    history.replaceState(null, '', location.pathname + location.search);
  }
}

export function token() {
  return sessionStorage.getItem(TOKEN) ?? '';
}

// ---- requests

// Raise an Error for what the dashboard refused; if it does not answer, fetch raises a TypeError.
export async function request(path, method = 'GET', body = undefined) {
  const headers = token() ? { Authorization: `Bearer ${token()}` } : {};
  const answer = await fetch(path, { method, headers, body });
  if (!answer.ok) throw new Error((await answer.text()).trim() || `${answer.status}`);
  return answer;
}

export async function ask(path) {
  return (await request(path)).json();
}

// Do what is repeated anyway; the banner says that the dashboard does not answer.
export async function unlessGone(action) {
  try {
    return await action();
  } catch (error) {
    if (error instanceof TypeError) return undefined;
    throw error;
  }
}

// Return a function that calls another one at most once in some time, unless forced.
export function throttled(pause_ms, action) {
  let busy = false, at = -Infinity;
  return async (force = false) => {
    if (busy || (!force && (performance.now() - at < pause_ms || document.hidden))) return;
    busy = true;
    try {
      await action();
    } finally {
      [busy, at] = [false, performance.now()];
    }
  };
}

export function save(blob, name) {
  const link = h('a', { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

export function download(label, path, name, title) {
  return button(label, async () => save(await (await request(path)).blob(), name), { title });
}

// ---- what stands above every page

export function showNavigation() {
  const ofRun = [['/run', 'Run'], ['/cluster', 'Servers'], ['/candidate', 'Candidate']];
  const links = [['/', 'Runs', '/'],
    ...(run ? ofRun : []).map(([path, text]) => [path, text, address(path)])];
  fill(document.getElementById('nav'), ...links.map(([path, text, href]) => h('a', {
    href, text, 'aria-current': path === location.pathname ? 'page' : null })));
}

export function showTheme() {
  const { dataset } = document.documentElement, chosen = localStorage.getItem(THEME);
  if (chosen) dataset.theme = chosen;
  document.getElementById('theme').addEventListener('click', () => {
    changeTheme();
    localStorage.setItem(THEME, dataset.theme);
  });
}
