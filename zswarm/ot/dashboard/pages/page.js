// Elements, numbers and addresses: what the pages share. Texts of a record become text, never markup.

const TOKEN = 'zswarm.token';
const THEME = 'zswarm.theme';
window.__zswarm = { frames: 0, messages: 0, seq: '', firstCurve: 0 };

// ---- elements

export function h(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === undefined || value === null || value === false) continue;
    if (name.startsWith('on')) made.addEventListener(name.slice(2), value);
    else if (name === 'text') made.textContent = value;
    else if (name === 'value' || name === 'checked') made[name] = value;
    else made.setAttribute(name, value === true ? '' : value);
  }
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

export function fill(element, ...children) {
  element.replaceChildren(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export function card(title, ...children) {
  return h('section', { class: 'card' }, h('h2', { text: title }), ...children);
}

export function copyButton(label, text) {
  const button = h('button', { type: 'button', text: label, onclick: async () => {
    const given = typeof text === 'function' ? text() : text;
    try {
      await navigator.clipboard.writeText(given);
    } catch {
      const area = h('textarea', { value: given, class: 'offscreen' });
      document.body.append(area);
      area.select();
      document.execCommand('copy');
      area.remove();
    }
    button.textContent = 'copied';
    setTimeout(() => { button.textContent = label; }, 1500);
  } });
  return button;
}

export function choice(label, options, chosen, onchange) {
  const name = `choice-${label.replace(/\W/g, '')}`;
  return h('fieldset', { class: 'choice' }, h('legend', { text: label }), ...options.map(([value, text]) => h('label', {},
    h('input', { type: 'radio', name, value, checked: value === chosen, onchange: () => onchange(value) }),
    h('span', { text }))));
}

export function showError(text) {
  const view = document.getElementById('view');
  fill(view, h('section', { class: 'card', role: 'alert' }, h('h1', { text: 'This cannot be shown' }), h('p', { text }),
    h('p', {}, h('a', { href: '/', text: 'All runs' }))));
}

// ---- numbers

export function number(value, digits = 5) {
  if (value === null || value === undefined || Number.isNaN(value)) return '–';
  if (Number.isInteger(value) && Math.abs(value) < 1e7) return value.toLocaleString('en');
  const text = Number(value.toPrecision(digits));
  return Math.abs(text) >= 1e7 || (text !== 0 && Math.abs(text) < 1e-4) ? text.toExponential(2) : String(text);
}

export function duration(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return '–';
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
  const day = then.toDateString() === new Date().toDateString() ? '' : `${then.toLocaleDateString('en-CA')} `;
  return day + then.toLocaleTimeString('en-GB');
}

export function ago(at) {
  return at ? `${duration(Date.now() / 1000 - at)} ago` : '–';
}

export function percent(share) {
  return `${(100 * share).toFixed(share < 0.0995 ? 1 : 0)} %`;
}

// ---- addresses

export const query = new URLSearchParams(location.search);
export const run = query.get('run') ?? '';

export function address(page, values = {}) {
  return `${page}?${new URLSearchParams({ run, ...values })}`;
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

function headers() {
  return token() ? { Authorization: `Bearer ${token()}` } : {};
}

// What the dashboard refused; when it is not there fetch raises a TypeError instead.
export class Refused extends Error {}

// For what is asked for again anyway: that the dashboard is gone is told by the banner.
export async function unlessGone(action) {
  try {
    return await action();
  } catch (error) {
    if (error instanceof TypeError) return undefined;
    throw error;
  }
}

export async function ask(path, form = 'json') {
  const answer = await fetch(path, { headers: headers() });
  if (!answer.ok) throw new Refused((await answer.text()).trim() || `${answer.status}`);
  return form === 'bytes' ? new Uint8Array(await answer.arrayBuffer()) : form === 'blob' ? answer.blob() : answer.json();
}

export function api(name, values = {}) {
  const given = new URLSearchParams(values).toString();
  return `/api/runs/${encodeURIComponent(run)}/${name}${given ? `?${given}` : ''}`;
}

export async function tell(path, value) {
  const answer = await fetch(path, { method: 'POST', headers: headers(), body: JSON.stringify(value) });
  if (!answer.ok) throw new Refused((await answer.text()).trim() || `${answer.status}`);
}

export function save(blob, name) {
  const link = h('a', { href: URL.createObjectURL(blob), download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

export function download(label, path, name) {
  return h('button', { type: 'button', text: label, onclick: async () => save(await ask(path, 'blob'), name) });
}

// ---- what stands above every page

export function showNavigation() {
  const links = [['/', 'Runs', '/']];
  if (run) links.push(['/run', 'Run', address('/run')], ['/cluster', 'Servers', address('/cluster')], ['/candidate', 'Candidate', address('/candidate')]);
  fill(document.getElementById('nav'), ...links.map(([path, text, href]) => h('a', {
    href, text, 'aria-current': path === location.pathname ? 'page' : undefined })));
}

export function showTheme() {
  const kept = localStorage.getItem(THEME);
  if (kept) document.documentElement.dataset.theme = kept;
  document.getElementById('theme').addEventListener('click', () => {
    const dark = document.documentElement.dataset.theme
      ? document.documentElement.dataset.theme === 'dark' : matchMedia('(prefers-color-scheme: dark)').matches;
    document.documentElement.dataset.theme = dark ? 'light' : 'dark';
    localStorage.setItem(THEME, document.documentElement.dataset.theme);
    window.dispatchEvent(new Event('recolour'));
  });
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => window.dispatchEvent(new Event('recolour')));
}

export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

// A word and a sign for a state, for colour alone says nothing to some.
const SIGNS = { running: '▶', paused: '❚❚', stopping: '◼', stopped: '◻', finished: '✓', unreadable: '✕', reading: '…' };
export function badge(status) {
  return h('span', { class: `badge ${status}`, text: `${SIGNS[status] ?? ''} ${status}` });
}
