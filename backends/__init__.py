"""Back ends: from cones in the car frame to a pose and a cone map."""
