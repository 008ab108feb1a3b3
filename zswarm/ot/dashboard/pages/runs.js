// All runs: a table, and the curves of those that are chosen, one over the other or as median and quartiles.
import { Chart } from './chart.js';
import { follow } from './live.js';
import { ago, ask, badge, card, choice, fill, h, number, setText, unlessGone } from './page.js';

const MOST = 14; // curves at once
const FRESH_MS = 3000; // curves of runs that go on are asked for this often

export async function show(view) {
  const runs = new Map();
  const curves = new Map(); // by id: columns, and when they were asked for
  const chosen = new Set(JSON.parse(sessionStorage.getItem('zswarm.chosen') ?? '[]'));
  let began = chosen.size > 0;
  let x = 'generation';
  let what = 'best';
  let grouped = 'each';
  let words = '';
  let order = ['at', -1];

  const chart = new Chart({ label: 'Fitness of the chosen runs', height: 320, xLabel: 'generation', hint: 'drag to look closely, arrows to read' });
  const body = h('tbody');
  const differences = h('details', { hidden: true }, h('summary', { text: 'what differs' }));
  differences.addEventListener('toggle', () => { if (differences.open) compare(); });
  const count = h('p', { class: 'dim small' });
  const heads = [['', ''], ['run', 'name'], ['state', 'status'], ['generation', 'generation', 'n'], ['best', 'best', 'n'], ['evaluations', 'evaluations', 'n'],
    ['simulator', 'simulator'], ['network', 'representation'], ['optimizer', 'optimizer'], ['seed', 'seed', 'n'], ['last', 'at', 'n']];
  const table = h('table', {}, h('thead', {}, h('tr', {}, ...heads.map(([text, key, kind]) => h('th', { class: kind, scope: 'col' },
    key ? h('button', { type: 'button', text, onclick: () => { order = [key, order[0] === key ? -order[1] : 1]; list(); } }) : null)))), body);
  fill(view,
    h('h1', { text: 'Runs' }),
    h('section', { class: 'card', 'aria-label': 'Curves' },
      h('div', { class: 'row between' },
        h('div', { class: 'row' },
          choice('Fitness', [['best', 'best'], ['mean', 'mean']], what, (value) => { what = value; draw(); }),
          choice('Along', [['generation', 'generations'], ['evaluations', 'evaluations'], ['time', 'wall time']], x, (value) => { x = value; draw(); }),
          choice('Runs', [['each', 'each run'], ['together', 'median and quartiles']], grouped, (value) => { grouped = value; draw(); })),
        h('div', { class: 'row' }, h('button', { type: 'button', text: 'none', onclick: () => { chosen.clear(); keep(); list(); draw(); } }),
          h('button', { type: 'button', text: 'PNG', onclick: () => chart.png('runs.png') }))),
      chart.element, differences),
    card('All runs',
      h('div', { class: 'row between' }, h('input', { type: 'search', placeholder: 'filter', 'aria-label': 'Filter runs', oninput: (event) => { words = event.target.value.toLowerCase(); list(); } }), count),
      h('div', { class: 'scroll tall' }, table)));

  function keep() {
    began = true;
    sessionStorage.setItem('zswarm.chosen', JSON.stringify([...chosen]));
  }

  function list() {
    const [key, direction] = order;
    const kept = [...runs.values()].filter((row) => `${row.id} ${row.simulator} ${row.representation} ${row.optimizer} ${row.status}`.toLowerCase().includes(words));
    kept.sort((a, b) => {
      const [left, right] = [a[key] ?? null, b[key] ?? null];
      if (left === null || right === null) return (left === null) - (right === null);
      return direction * (typeof left === 'string' ? left.localeCompare(right, 'en', { numeric: true }) : left - right);
    });
    setText(count, runs.size ? `${kept.length} of ${runs.size}` : 'no run yet: zswarm-ot run makes one, and it comes up here by itself');
    fill(body, ...kept.slice(0, 1000).map((row) => {
      const box = h('input', { type: 'checkbox', checked: chosen.has(row.id), 'aria-label': `draw ${row.name}`, onchange: () => {
        if (box.checked) chosen.add(row.id); else chosen.delete(row.id);
        keep();
        load();
      } });
      const name = row.study ? `${row.study.replaceAll('~', '/')}/${row.name}` : row.name;
      if (row.error) return h('tr', {}, h('td'), h('td', { class: 'name', text: name }), h('td', {}, badge('unreadable')), h('td', { class: 'why', colspan: 8, text: row.error }));
      return h('tr', {}, h('td', {}, box),
        h('td', { class: 'name' }, h('a', { href: `/run?${new URLSearchParams({ run: row.id })}`, text: name })), h('td', {}, badge(row.status)),
        h('td', { class: 'n', text: `${number(row.generation)} / ${number(row.generations)}` }), h('td', { class: 'n', text: number(row.best) }),
        h('td', { class: 'n', text: number(row.evaluations) }), h('td', { text: row.simulator }), h('td', { text: row.representation }),
        h('td', { text: row.optimizer }), h('td', { class: 'n', text: String(row.seed) }), h('td', { class: 'n', text: ago(row.at) }));
    }));
  }

  async function load() {
    const now = performance.now();
    const missing = [...chosen].filter((id) => runs.has(id)).slice(0, MOST).filter((id) => {
      const have = curves.get(id);
      return !have || (have.generation !== runs.get(id).generation && now - have.asked > FRESH_MS);
    });
    await Promise.all(missing.map(async (id) => {
      const generation = runs.get(id).generation;
      curves.set(id, { ...curves.get(id), generation, asked: now });
      try {
        const columns = await ask(`/api/runs/${encodeURIComponent(id)}/curve?points=600`);
        curves.set(id, { ...curves.get(id), columns });
      } catch { /* it is in the table, with why */ }
    }));
    draw();
    compare();
  }

  // The settings in which the chosen runs differ, and what they came to.
  async function compare() {
    const shown = [...chosen].filter((id) => runs.has(id) && !runs.get(id).error).slice(0, MOST);
    differences.hidden = shown.length < 2;
    if (!differences.open || differences.hidden) return;
    const each = await unlessGone(() => Promise.all(shown.map((id) => ask(`/api/runs/${encodeURIComponent(id)}/settings`))));
    if (!each) return;
    const keys = [...new Set(each.flatMap((one) => Object.keys(one)))].filter((key) => new Set(each.map((one) => one[key])).size > 1);
    const rows = [...keys.map((key) => [key, ...each.map((one) => one[key] ?? '–')]),
      ['best', ...shown.map((id) => number(runs.get(id).best))], ['generation', ...shown.map((id) => number(runs.get(id).generation))], ['evaluations', ...shown.map((id) => number(runs.get(id).evaluations))]];
    fill(differences, h('summary', { text: 'what differs' }), h('div', { class: 'scroll' }, h('table', {},
      h('thead', {}, h('tr', {}, h('th'), ...shown.map((id) => h('th', { scope: 'col', text: id.replaceAll('~', '/') })))),
      h('tbody', {}, ...rows.map(([name, ...values]) => h('tr', {}, h('th', { scope: 'row', text: name }), ...values.map((text) => h('td', { class: 'wrap', text }))))))));
  }

  function along(columns) {
    if (x === 'generation') return columns.generation.map((value) => value + 1);
    if (x === 'evaluations') return columns.evaluations;
    const begin = columns.at[0];
    return columns.at.map((at) => at - begin);
  }

  function draw() {
    const shown = [...chosen].filter((id) => curves.get(id)?.columns?.generation.length && runs.has(id)).slice(0, MOST);
    const all = shown.map((id) => ({ name: id.replaceAll('~', '/'), x: along(curves.get(id).columns), y: curves.get(id).columns[what], steps: what === 'best' }));
    const labels = { generation: 'generation', evaluations: 'evaluations', time: 'since the first generation' };
    const options = { xLabel: labels[x], time: x === 'time' };
    if (grouped === 'each' || all.length < 2) chart.set(all, options);
    else chart.set(together(all), options);
  }

  follow('', (message) => {
    if (message.hello) runs.clear();
    for (const row of message.runs ?? []) runs.set(row.id, row);
    for (const id of message.gone ?? []) { runs.delete(id); curves.delete(id); }
    if (!began && runs.size) {
      const last = [...runs.values()].filter((row) => !row.error && row.generation).sort((a, b) => (b.at ?? 0) - (a.at ?? 0));
      for (const row of last.slice(0, 5)) chosen.add(row.id);
    }
    if (message.runs || message.gone) { list(); load(); }
  });
  setInterval(load, FRESH_MS);
}

// Median and quartiles over runs, where at least two are that far; a run stays at its last value.
function together(all) {
  const end = Math.max(...all.map((one) => one.x[one.x.length - 1]));
  const begin = Math.min(...all.map((one) => one.x[0]));
  const xs = Array.from({ length: 200 }, (_, i) => begin + (end - begin) * i / 199);
  const columns = { low: [], median: [], high: [] };
  for (const x of xs) {
    const values = all.filter((one) => one.x[0] <= x && x <= one.x[one.x.length - 1]).map((one) => value(one, x)).filter((y) => y !== null).sort((a, b) => a - b);
    columns.low.push(values.length > 1 ? quantile(values, 0.25) : null);
    columns.median.push(values.length ? quantile(values, 0.5) : null);
    columns.high.push(values.length > 1 ? quantile(values, 0.75) : null);
  }
  return [{ name: 'quartiles', x: xs, low: columns.low, high: columns.high, colour: '--c1' },
    { name: `median of ${all.length} runs`, x: xs, y: columns.median, colour: '--c1', dash: [] },
    ...all.map((one) => ({ ...one, colour: '--dim', thin: true, dash: [2, 3] }))];
}

function value(one, x) {
  let [low, high] = [0, one.x.length - 1];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (one.x[middle] <= x) low = middle; else high = middle - 1;
  }
  return one.y[low];
}

export function quantile(sorted, share) {
  const at = (sorted.length - 1) * share;
  const below = Math.floor(at);
  return sorted[below] + (at - below) * ((sorted[below + 1] ?? sorted[below]) - sorted[below]);
}
