"""Find parts by name, and hash the code behind them."""
