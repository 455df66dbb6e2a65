"""Work–precision benchmarks of the dynamics: time against true error of every method, with peers in the same run."""
