"""Work–precision benchmark of the estimators: time against error over the Fisher bound, with peers in the same run."""
