// Which page this is, by its address; and what all pages have.
import { keepToken, showNavigation, showTheme, showError } from './page.js';

keepToken();
showTheme();
const pages = { '/': './runs.js', '/run': './run.js', '/cluster': './cluster.js', '/candidate': './candidate.js' };
showNavigation();
try {
  const page = await import(pages[location.pathname] ?? './runs.js');
  await page.show(document.getElementById('view'));
} catch (error) {
  showError(error.message ?? String(error));
}
