"""What every command line shares: one-line refusals, progress bars, Ctrl-C."""
