"""Commands to kill and starve, the trials, and the checks of the files that commands leave."""
