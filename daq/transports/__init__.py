"""Byte streams in and out, and the host clock. Nothing above may ask what is behind them."""
