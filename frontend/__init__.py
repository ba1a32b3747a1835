"""Front end: from pixels to cones in the car frame."""
