"""Many runs of one mission: a battery of weathers and plants, a grid of numbers, a tuning."""
