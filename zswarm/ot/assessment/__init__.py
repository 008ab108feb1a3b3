"""The assessment that ends a run: candidates race on seeds that evolution never uses."""
