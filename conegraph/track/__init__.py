"""Where the road is: ordered boundaries, road surface and centre line of a cone map."""
