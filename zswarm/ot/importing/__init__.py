"""Runs made of files that other programs wrote: results of FREVO, controllers of ARGoS."""
