"""Effects of the drive: where collars stand when joints are commanded."""
