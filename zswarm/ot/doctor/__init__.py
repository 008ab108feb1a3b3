"""What ``zswarm-ot doctor`` looks at, one function each, and how each fault is mended."""
