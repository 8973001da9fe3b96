"""Commands that are killed and starved, the trials, and the checks of the files that they leave."""
