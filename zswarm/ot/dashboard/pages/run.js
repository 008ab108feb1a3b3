// One run: how far it is, its curves, what happened, what was run, and what may be asked of it.
import { Chart } from './chart.js';
import { follow } from './live.js';
import { address, ago, api, ask, badge, card, choice, clock, copyButton, download, duration, fill, h, number, run, setText, showError, tell, token, unlessGone } from './page.js';

const MOST = 4000; // points that come live before the curve is asked for anew
const SLOW_MS = 4000; // between looks at what takes a look at all candidates

export async function show(view) {
  let about = null;
  let state = { status: 'reading' };
  let x = 'generation';
  let curve = { generation: [], at: [], best: [], mean: [], low: [], high: [], evaluations: [] };
  let spread = null;
  let statistics = null;
  let events = [];
  let level = 'info';
  let slowAt = 0;
  let picked = null;

  const title = h('h1', { text: run });
  const status = h('span', {}, badge('reading'));
  const notes = h('div');
  const progress = h('progress', { max: 1, value: 0, 'aria-label': 'generations done' });
  const inner = h('p', { class: 'dim small' });
  const names = ['generation', 'best', 'mean', 'evaluations', 'evaluations/s', 'time left', 'servers', 'slots', 'sent again'];
  const tiles = Object.fromEntries(names.map((name) => [name, h('dd', { text: '–' })]));
  const controls = h('div', { class: 'row' });
  const fitness = new Chart({ label: 'Fitness: best, mean, and quartiles of the candidates', height: 320, xLabel: 'generation', hint: 'drag to look closely, click or Enter to choose a generation', onpick: pick });
  const diversity = new Chart({ label: 'Diversity', height: 200, xLabel: 'generation' });
  const operators = new Chart({ label: 'Effectivity of the operators', height: 200, xLabel: 'generation' });
  const others = new Chart({ label: 'Other numbers of the optimizer', height: 200, xLabel: 'generation' });
  const choices = { diversity: card('Diversity', diversity.element), operators: card('Effectivity of operators', operators.element), others: card('Other numbers of the optimizer', others.element) };
  for (const one of Object.values(choices)) one.hidden = true;
  const chosen = h('p', { class: 'small' });
  const log = h('ul', { class: 'log' });
  const older = h('button', { type: 'button', class: 'small', text: 'older ones', onclick: more });
  const panel = h('section', { class: 'card' }, h('h2', { text: 'What was run' }));
  const champions = h('section', { class: 'card' }, h('h2', { text: 'Champions' }));

  fill(view,
    h('section', { class: 'card' },
      h('div', { class: 'row between' }, h('div', { class: 'row' }, title, status), controls), notes, progress, inner,
      h('dl', { class: 'tiles' }, ...names.map((name) => h('div', { class: 'tile' }, h('dt', { text: name }), tiles[name])))),
    h('section', { class: 'card' },
      h('div', { class: 'row between' }, h('h2', { text: 'Fitness' }),
        h('div', { class: 'row' }, choice('Along', [['generation', 'generations'], ['time', 'wall time']], x, (value) => { x = value; draw(); }),
          download('CSV', api('history.csv'), `${run}.csv`), download('JSON', api('history.json'), `${run}.json`),
          h('button', { type: 'button', text: 'PNG', onclick: () => fitness.png(`${run}.png`) }))),
      fitness.element, chosen),
    h('div', { class: 'two' }, choices.diversity, choices.operators, choices.others),
    h('div', { class: 'two' }, h('div', { class: 'stack' }, h('section', { class: 'card' },
      h('div', { class: 'row between' }, h('h2', { text: 'Events' }),
        choice('Show', [['info', 'all'], ['warning', 'warnings'], ['error', 'errors']], level, (value) => { level = value; list(); })),
      h('div', { class: 'scroll' }, log), older), champions), panel));

  // ---- what is shown

  function along(columns, generation = columns.generation) {
    if (x === 'generation') return generation.map((value) => value + 1);
    const begin = about?.meta.created_at ?? curve.at[0];
    return columns.at.map((at) => at - begin);
  }

  function draw() {
    const options = { xLabel: x === 'time' ? 'since the run began' : 'generation', time: x === 'time' };
    const sparse = curve.low.some((low, i) => low !== null && low !== curve.high[i]);
    fitness.set([
      ...(spread?.generation.length ? [{ name: 'quartiles', x: along(spread), low: spread.lower, high: spread.upper, colour: '--c3' }] : []),
      ...(sparse && !spread ? [{ name: 'range of means', x: along(curve), low: curve.low, high: curve.high, colour: '--c2' }] : []),
      { name: 'best', x: along(curve), y: curve.best, colour: '--c1', dash: [], steps: true },
      { name: 'mean', x: along(curve), y: curve.mean, colour: '--c2', dash: [7, 4] },
      ...(spread?.generation.length ? [{ name: 'median', x: along(spread), y: spread.median, colour: '--c3', dash: [2, 3] }] : []),
    ], options);
    if (!statistics) return;
    const xs = along(statistics);
    const each = (test, cut) => Object.entries(statistics.values).filter(([name]) => test(name)).map(([name, y]) => ({ name: cut(name), x: xs, y }));
    const sets = {
      diversity: each((name) => name.startsWith('diversity_'), (name) => name.slice(10)),
      operators: each((name) => name.startsWith('effectivity_'), (name) => name.slice(12)),
      others: each((name) => !/^(diversity_|effectivity_|count_|best$|mean$|evaluations$)/.test(name), (name) => name).slice(0, 14),
    };
    for (const [name, chart] of Object.entries({ diversity, operators, others })) {
      choices[name].hidden = !sets[name].length;
      if (sets[name].length) chart.set(sets[name], options);
    }
  }

  function showState() {
    fill(status, badge(state.status));
    if (state.error) { fill(notes, h('p', { class: 'note', text: state.error })); return; }
    const done = state.generation ?? 0;
    progress.max = state.generations || 1;
    progress.value = done + (state.trials ? Math.min(1, state.counted / state.trials) : 0);
    setText(inner, state.status === 'running' && state.trials
      ? `generation ${done + 1}: ${number(Math.min(state.counted, state.trials))} of ${number(state.trials)} trials` : state.at ? `last recorded ${ago(state.at)}` : '');
    const values = {
      generation: `${number(done)} / ${number(state.generations)}`, best: number(state.best), mean: number(state.mean), evaluations: number(state.evaluations),
      'evaluations/s': state.status === 'running' ? (state.rate === null ? `${number(state.trial_rate)} games/s` : number(state.rate, 3)) : '–',
      'time left': duration(state.eta_s), servers: number(state.servers), slots: number(state.slots), 'sent again': number(state.requeued),
    };
    for (const [name, value] of Object.entries(values)) setText(tiles[name], value);
    showControls();
  }

  function showControls() {
    const going = ['running', 'paused', 'stopping'].includes(state.status);
    const key = `${going} ${state.status} ${state.asked} ${Boolean(token())}`;
    if (controls.dataset.key === key) return;
    controls.dataset.key = key;
    if (!going) { fill(controls); return; }
    const button = (text, word, kind, question) => h('button', { type: 'button', class: kind, text, disabled: !token(),
      title: token() ? '' : 'takes the token: open the address that the dashboard printed', onclick: async () => {
        if (question && !confirm(question)) return;
        try { await tell(api('control'), { ask: word }); } catch (error) { fill(notes, h('p', { class: 'note', text: error.message })); }
      } });
    fill(controls, state.asked ? button('Go on', 'go on', 'main') : button('Pause', 'pause', ''),
      button('Stop after this generation', 'drain', ''), button('Stop', 'stop', 'danger', 'Stop this run? Nothing is lost: zswarm-ot resume goes on.'));
  }

  function list() {
    const grave = { info: 0, warning: 1, error: 2 };
    const kept = events.filter((event) => grave[event.level] >= grave[level]);
    const signs = { info: '·', warning: '▲', error: '✕' };
    fill(log, ...(kept.length ? kept.slice(-2000).reverse().map((event) => h('li', {},
      h('span', { class: 'when', text: clock(event.at), title: event.generation === null ? '' : `generation ${event.generation + 1}` }),
      h('span', { class: event.level, text: signs[event.level], 'aria-label': event.level, role: 'img' }),
      h('span', { class: `what ${event.level}`, text: event.event.replaceAll('_', ' ') + (event.count ? ` (${number(event.count)})` : '') }),
      h('span', { class: 'detail wrap', text: [event.server, event.text].filter(Boolean).join(': ') }))) : [h('li', { class: 'dim', text: 'none' })]));
  }

  async function more() {
    const before = events.length ? events[0].id : 2 ** 50;
    const found = await ask(api('events', { before }));
    events = [...found.reverse(), ...events];
    older.hidden = !found.length;
    list();
  }

  function pick(value) {
    const generations = along(curve);
    const at = generations.reduce((best, one, i) => (Math.abs(one - value) < Math.abs(generations[best] - value) ? i : best), 0);
    picked = curve.generation[at];
    fill(chosen, h('span', { text: `generation ${picked + 1}: ` }), h('a', { href: address('/candidate', { generation: picked }), text: 'look at its best candidate' }));
  }

  async function showAbout() {
    about = await ask(api('about'));
    document.title = `${about.name} · zswarm`;
    setText(title, about.name);
    const facts = [['seed', about.seed], ['simulator', about.simulator], ['network', about.representation], ['optimizer', about.optimizer], ['ranking', about.ranking],
      ['history', about.meta.history_hash], ['version hash', about.meta.version_hash], ['zswarm', about.meta.zswarm], ['machine', about.meta.machine],
      ['resumed', about.meta.epoch ? `${about.meta.epoch} times` : null], ['folder', about.folder]];
    fill(panel, h('h2', { text: 'What was run' }),
      h('div', { class: 'row' }, copyButton('copy experiment', about.experiment), copyButton('copy seed', String(about.seed)),
        about.meta.history_hash ? copyButton('copy history hash', about.meta.history_hash) : null),
      h('table', {}, h('tbody', {}, ...facts.filter(([, value]) => value !== null && value !== undefined).map(([name, value]) => h('tr', {}, h('th', { scope: 'row', text: name }), h('td', { class: 'wrap', text: String(value) }))))),
      h('h3', { text: 'experiment.toml' }), h('pre', { text: about.experiment, tabindex: 0 }));
    const said = [];
    if (about.changed.length) said.push(`experiment.toml was changed after the run began (${about.changed.join(', ')}); this page shows what was run`);
    const marks = await ask(api('marks'));
    if (marks.faulted) said.push(`${number(marks.faulted)} trials were counted as faults`);
    if (marks.doubtful) said.push(`${number(marks.doubtful)} trials came from a server that was later proved to compute wrong`);
    if (about.meta.imported_from) said.push(`imported from ${about.meta.imported_from}`);
    fill(notes, ...said.map((text) => h('p', { class: 'note', text })));
  }

  async function showChampions() {
    const found = await ask(api('champions'));
    fill(champions, h('h2', { text: 'Champions' }), found.length ? h('div', { class: 'scroll' }, h('table', {},
      h('thead', {}, h('tr', {}, ...['generation', 'candidate', 'fitness', ''].map((text) => h('th', { text, scope: 'col', class: text ? 'n' : '' })))),
      h('tbody', {}, ...found.reverse().slice(0, 100).map((one) => h('tr', {}, h('td', { class: 'n', text: number(one.generation + 1) }), h('td', { class: 'n', text: number(one.candidate) }),
        h('td', { class: 'n', text: number(one.fitness) }), h('td', {}, h('a', { href: address('/candidate', { generation: one.generation, candidate: one.candidate }), text: 'look' }))))))) : h('p', { class: 'dim', text: 'none yet' }));
  }

  async function loadCurve() {
    const loaded = await ask(api('curve'));
    const last = loaded.generation.at(-1) ?? -1;
    const late = curve.generation.map((generation, i) => i).filter((i) => curve.generation[i] > last);
    for (const name of Object.keys(loaded)) loaded[name].push(...late.map((i) => curve[name][i]));
    curve = loaded;
    draw();
  }

  let slow = false;
  async function loadSlow(force = false) {
    if (slow || (!force && (performance.now() - slowAt < SLOW_MS || document.hidden))) return;
    slow = true;
    try {
      [spread, statistics] = await Promise.all([ask(api('spread')), ask(api('statistics'))]);
      draw();
      await showChampions();
    } finally {
      slow = false;
      slowAt = performance.now();
    }
  }

  // ---- what comes

  let asked = false; // all was there once
  let tried = false;
  async function loadAll() {
    try {
      await loadCurve();
      await showAbout();
      asked = true;
      await loadSlow(true);
    } catch (error) {
      if (!(error instanceof TypeError)) showError(error.message);
    }
  }

  follow(run, (message) => {
    if (message.state) {
      const ended = state.status === 'running' && message.state.status !== 'running';
      state = message.state;
      if (ended) unlessGone(async () => { await showAbout(); await loadSlow(true); });
    }
    if (message.hello) { events = message.events; older.hidden = events.length < 300; list(); if (asked) unlessGone(loadCurve); else if (tried) loadAll(); }
    else if (message.events) { events.push(...message.events); if (events.length > 5000) events = events.slice(-4000); list(); }
    for (const [generation, at, best, mean, evaluations] of message.generations ?? []) {
      if (generation <= (curve.generation.at(-1) ?? -1)) continue;
      for (const [name, value] of Object.entries({ generation, at, best, mean, low: mean, high: mean, evaluations })) curve[name].push(value);
    }
    showState();
    if (message.generations) {
      if (curve.generation.length > MOST) unlessGone(loadCurve); else draw();
      if (asked) unlessGone(loadSlow);
    }
  });
  await loadAll();
  tried = true;
  setInterval(() => { if (state.status !== 'running') showState(); }, 2000);
}
