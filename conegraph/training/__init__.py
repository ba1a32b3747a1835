"""Training of the learned detector: pictures that are made up, a network, its loss."""
