"""The discrete equations of one capsule in its flow: membrane load, liquids, Newton's method, motion in time."""
