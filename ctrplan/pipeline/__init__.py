"""The chain: commanded joints -> clock -> drive -> mechanics -> sensor."""
