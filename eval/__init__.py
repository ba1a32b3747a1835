"""The judge: what a run wrote down, against the truth."""
