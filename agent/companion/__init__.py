"""The companion computer: odometry, map, obstacle detection and tracking, collision check and avoidance."""
