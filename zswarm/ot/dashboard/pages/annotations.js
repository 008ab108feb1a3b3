// Tags and the note of a run, which are written into its folder.
import { TAKES_TOKEN, api, button, card, h, request, row, setText, token } from './page.js';

const SEPARATOR = ',';

// Make the card of a run's tags and note.
export function annotationsCard({ note, tags }) {
  const allowed = Boolean(token()), said = h('span', { class: 'dim small', role: 'status' });
  const changed = () => setText(said, 'not saved yet');
  const words = h('input', { type: 'text', value: tags.join(`${SEPARATOR} `), disabled: !allowed,
    placeholder: 'baseline, paper', oninput: changed });
  const text = h('textarea', { rows: 3, value: note, disabled: !allowed, oninput: changed,
    placeholder: 'why this run was made, what it showed' });
  const save = button('Save', async () => {
    const given = words.value.split(SEPARATOR).map((tag) => tag.trim()).filter(Boolean);
    try {
      await request(api('note'), 'POST', JSON.stringify({ tags: given, note: text.value }));
      setText(said, 'saved');
    } catch (error) {
      setText(said, error.message);
    }
  }, { disabled: !allowed, title: allowed ? null : TAKES_TOKEN });
  return card('Tags and note', h('label', { class: 'wide' }, 'tags, with commas between them', words),
    h('label', { class: 'wide' }, 'note', text), row(save, said));
}
