"""Traces of a trial, and the page that plays them."""
