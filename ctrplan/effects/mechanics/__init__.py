"""Effects of the mechanics: which shape the tubes take."""
