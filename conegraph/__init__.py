"""Cone SLAM for Formula Student Driverless: front end, back ends, judge."""
