// How much each setting explains of the differences between runs.
import { ask, h, note, row, table, unlessGone } from './page.js';

const MOST = 12; // effects that are listed

// Fill an element with the importance of the settings of some runs; their fitness must compare.
export async function showImportance(element, runs) {
  const query = new URLSearchParams({ runs: runs.map(({ id }) => id).join(' ') });
  const found = await unlessGone(() => ask(`/api/importance?${query}`));
  if (!found) return;
  if (found.why) {
    element.replaceChildren(note(`not computed, because ${found.why}`, 'dim small'));
    return;
  }
  const rows = found.effects.slice(0, MOST).map(({ settings, eta2, epsilon2 }) => [
    settings.join(' × '), bar(eta2), [percent(eta2), 'n'], [epsilon2 === null ? '–' : percent(epsilon2), 'n']]);
  if (found.rest >= 0.001) rows.push(['interactions of three and more', bar(found.rest), [percent(found.rest), 'n'], '']);
  const repeated = found.noise !== null;
  if (repeated) rows.push(['differences between repeats', bar(found.noise), [percent(found.noise), 'n'], '']);
  element.replaceChildren(
    table(['setting', '', ['share', 'n'], ['beyond chance', 'n']], rows),
    row(h('p', { class: 'dim small', text: `Share of the variance of best fitness in search between ${
      found.runs} runs (eta squared), and without what chance explains (epsilon squared). `
      + `a × b: how far the effect of a depends on b.${repeated ? '' : ' Without repeats, chance has a part in each share.'}` })));
}

function bar(share) {
  const filled = h('i');
  filled.style.width = percent(share);
  return h('span', { class: 'bar' }, filled);
}

function percent(share) {
  return `${(100 * share).toFixed(1)}%`;
}
