"""The dashboard: a page that shows runs, read from their folders."""
