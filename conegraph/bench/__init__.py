"""The benchmarks: many runs against known truth, and the verdict they give."""
