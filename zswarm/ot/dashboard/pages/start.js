// Show the page of this address, and what all pages have.
import { keepToken, showError, showNavigation, showTheme } from './page.js';

const PAGES = { '/run': './run.js', '/cluster': './cluster.js', '/candidate': './candidate.js' };
keepToken();
showTheme();
showNavigation();
try {
  const page = await import(PAGES[location.pathname] ?? './runs.js');
  await page.show(document.getElementById('view'));
} catch (error) {
  showError(error.message ?? String(error));
}
