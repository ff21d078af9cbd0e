"""Names of experiments go in; run folders, evaluations and reports come out."""
