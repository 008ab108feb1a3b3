// The servers of a run: what each does, how well, why one does nothing; and when their slots computed.
import { follow } from './live.js';
import { ago, api, ask, badge, card, choice, clock, colour, duration, fill, h, number, percent, run, setText, showError, unlessGone } from './page.js';

const SLOW_MS = 3000;
const ROW = 18; // pixels of a server in the timeline
const MARKS = { server_left: '◁', server_lost: '✕', server_joined: '▷', server_back: '▷', fault: '▲' };

export async function show(view) {
  const servers = new Map();
  let state = { status: 'reading' };
  let timeline = null;
  let seconds = 0;
  let words = '';
  let order = ['trials', -1];
  const status = h('span', {}, badge('reading'));
  const summary = h('p', { class: 'dim' });
  const body = h('tbody');
  const rows = new Map(); // the elements of each server
  const heads = [['server', 'server'], ['state', 'state'], ['leased', 'leased', 'n'], ['slots', 'slots', 'n'], ['trials', 'trials', 'n'], ['share of work', 'share'], ['trials/s', 'rate', 'n'],
    ['last minute', ''], ['ms per trial', 'trial_ms', 'n'], ['last result', 'last_at', 'n'], ['faults', 'faults', 'n'], ['losses', 'losses', 'n'], ['why', 'why']];
  const table = h('table', { id: 'servers' }, h('thead', {}, h('tr', {}, ...heads.map(([text, key, kind]) => h('th', { class: kind, scope: 'col' },
    key ? h('button', { type: 'button', text, onclick: () => { order = [key, order[0] === key ? -order[1] : key === 'server' ? 1 : -1]; list(); } }) : text)))), body);
  const canvas = h('canvas', { tabindex: 0, role: 'img', 'aria-label': 'When the slots of each server computed' });
  const readout = h('p', { class: 'readout', 'aria-live': 'polite' });
  const figure = h('figure', { class: 'chart timeline' }, canvas, h('div', { class: 'under' }, readout));

  fill(view,
    h('section', { class: 'card' }, h('div', { class: 'row' }, h('h1', { text: 'Servers' }), status), summary,
      h('input', { type: 'search', placeholder: 'filter', 'aria-label': 'Filter servers', oninput: (event) => { words = event.target.value.toLowerCase(); list(); } }),
      h('div', { class: 'scroll tall' }, table)),
    card('When slots computed',
      h('div', { class: 'row between' }, h('p', { class: 'dim small', text: 'Full height: all slots of the server computed; empty: none did. ▷ joined, ◁ left, ✕ lost, ▲ fault; a line: the run began or went on.' }),
        choice('Time', [[60, '1 min'], [600, '10 min'], [0, 'all recorded']], seconds, (value) => { seconds = value; unlessGone(() => load(true)); })),
      h('div', { class: 'scroll tall' }, figure)));

  function list() {
    const [key, direction] = order;
    const kept = [...servers.values()].filter((row) => `${row.server} ${row.state} ${row.why}`.toLowerCase().includes(words));
    kept.sort((a, b) => (typeof a[key] === 'string' ? a[key].localeCompare(b[key], 'en', { numeric: true }) : (a[key] ?? -1) - (b[key] ?? -1)) * direction
      || a.server.localeCompare(b.server, 'en', { numeric: true }));
    const shown = kept.map((row) => update(row));
    if (shown.length !== body.children.length || shown.some((element, i) => body.children[i] !== element)) fill(body, ...shown);
    const computing = [...servers.values()].filter((row) => row.slots).length;
    const going = ['running', 'paused', 'stopping'].includes(state.status);
    setText(summary, servers.size ? `${number(servers.size)} seen${going ? `, ${number(computing)} compute with ${number(state.slots)} slots; ${number(state.trial_rate)} trials/s` : '; the run does not go on now'}` : 'no server yet');
  }

  function update(row) {
    let kept = rows.get(row.server);
    if (!kept) {
      const cells = Object.fromEntries(['state', 'leased', 'slots', 'trials', 'rate', 'trial_ms', 'last_at', 'faults', 'losses', 'why'].map((name) => [name, h('td', { class: { state: 'state', why: 'why' }[name] ?? 'n' })]));
      const bar = h('i');
      const share = h('span', { class: 'dim small' });
      const spark = h('canvas', { class: 'spark', width: 180, height: 40, 'aria-hidden': 'true' });
      const health = h('span', { class: 'health' });
      cells.state.append(health);
      const element = h('tr', {}, h('td', { class: 'name', text: row.server }), cells.state, cells.leased, cells.slots, cells.trials,
        h('td', {}, h('span', { class: 'bar' }, bar), share), cells.rate, h('td', {}, spark), cells.trial_ms, cells.last_at, cells.faults, cells.losses, cells.why);
      kept = { element, cells, bar, share, spark, health };
      rows.set(row.server, kept);
    }
    if (kept.row !== row) {
      kept.row = row;
      kept.health.className = `health ${row.health}`;
      setText(kept.health, row.state || '–');
      kept.bar.style.width = `${100 * row.share}%`;
      setText(kept.share, percent(row.share));
      for (const name of ['leased', 'slots', 'trials', 'rate', 'faults', 'losses']) setText(kept.cells[name], number(row[name], 4));
      setText(kept.cells.trial_ms, number(row.trial_ms, 3));
      setText(kept.cells.why, row.why);
      paintSpark(kept.spark, row.spark);
    }
    setText(kept.cells.last_at, ago(row.last_at));
    return kept.element;
  }

  function paintSpark(canvas, values) {
    const pen = canvas.getContext('2d');
    pen.clearRect(0, 0, 180, 40);
    const most = Math.max(...values);
    if (!most) return;
    pen.fillStyle = colour('--c1');
    values.forEach((value, i) => { const height = 38 * value / most; pen.fillRect(i * 6, 40 - height, 5, height); });
  }

  // ---- the timeline

  function draw() {
    if (!timeline) return;
    const names = Object.keys(timeline.busy).sort((a, b) => a.localeCompare(b, 'en', { numeric: true }));
    const width = figure.clientWidth;
    if (!width) return;
    const left = Math.min(210, Math.max(90, width * 0.24));
    const height = names.length * ROW + 26;
    const scale = window.devicePixelRatio || 1;
    canvas.width = width * scale;
    canvas.height = height * scale;
    canvas.style.height = `${height}px`;
    const pen = canvas.getContext('2d');
    pen.scale(scale, scale);
    pen.font = '12px system-ui, sans-serif';
    const wide = (width - left - 8) / timeline.bins;
    names.forEach((name, row) => {
      const slots = Math.max(1, timeline.slots[name] ?? 1);
      const base = row * ROW + ROW - 2;
      pen.fillStyle = colour('--bar');
      pen.fillRect(left, row * ROW + 2, width - left - 8, ROW - 4);
      pen.fillStyle = colour('--c1');
      timeline.busy[name].forEach((busy, i) => {
        const tall = (ROW - 4) * Math.min(1, busy / slots);
        if (tall > 0.2) pen.fillRect(left + i * wide, base - tall, Math.max(1, wide - 0.2), tall);
      });
      pen.fillStyle = colour('--fg');
      pen.textBaseline = 'middle';
      pen.textAlign = 'left';
      pen.fillText(shorten(pen, name, left - 10), 0, row * ROW + ROW / 2);
    });
    const span = timeline.end - timeline.begin;
    const at = (when) => left + (when - timeline.begin) / span * (width - left - 8);
    pen.textAlign = 'center';
    for (const event of timeline.events) {
      const row = names.indexOf(event.server);
      pen.fillStyle = colour(event.event === 'server_joined' || event.event === 'server_back' ? '--good' : '--bad');
      if (event.event === 'began') { pen.fillStyle = colour('--dim'); pen.fillRect(at(event.at), 0, 1, names.length * ROW); }
      if (row >= 0) pen.fillText(MARKS[event.event] ?? '·', at(event.at), row * ROW + ROW / 2);
    }
    pen.fillStyle = colour('--dim');
    for (const share of width > 600 ? [0, 0.25, 0.5, 0.75, 1] : [0, 0.5, 1]) {
      pen.textAlign = share === 0 ? 'left' : share === 1 ? 'right' : 'center';
      pen.fillText(share === 1 ? clock(timeline.end) : `−${duration(span * (1 - share))}`, left + share * (width - left - 8), names.length * ROW + 14);
    }
    canvas.onpointermove = (event) => {
      const name = names[Math.floor(event.offsetY / ROW)];
      const bin = Math.floor((event.offsetX - left) / wide);
      if (!name || bin < 0 || bin >= timeline.bins) { setText(readout, ''); return; }
      setText(readout, `${name}, ${clock(timeline.begin + span * bin / timeline.bins)}: ${number(timeline.busy[name][bin], 3)} of ${number(timeline.slots[name] ?? 1)} slots computed`);
    };
    window.__zswarm.frames += 1;
  }

  let loading = false;
  let loadedAt = -1e9;
  async function load(force = false) {
    if (loading || (!force && (performance.now() - loadedAt < SLOW_MS || document.hidden))) return;
    loading = true;
    try {
      timeline = await ask(api('timeline', seconds ? { seconds } : {}));
      draw();
    } finally {
      loading = false;
      loadedAt = performance.now();
    }
  }

  new ResizeObserver(draw).observe(figure);
  window.addEventListener('recolour', () => { draw(); for (const kept of rows.values()) paintSpark(kept.spark, kept.row.spark); });
  follow(run, (message) => {
    if (message.hello) servers.clear();
    if (message.state) { state = message.state; fill(status, badge(state.status)); if (state.error) showError(state.error); }
    for (const row of message.servers ?? []) servers.set(row.server, row);
    if (message.hello || message.servers || message.state) { list(); unlessGone(load); }
  });
  setInterval(list, 2000);
  try {
    const about = await ask(api('about'));
    document.title = `Servers of ${about.name} · zswarm`;
    await load(true);
  } catch (error) {
    if (!(error instanceof TypeError)) showError(error.message);
  }
}

function shorten(pen, text, room) {
  if (pen.measureText(text).width <= room) return text;
  let kept = text;
  while (kept.length > 3 && pen.measureText(`${kept}…`).width > room) kept = kept.slice(0, -1);
  return `${kept}…`;
}
