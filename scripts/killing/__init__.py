"""The killer of commands: which commands, when they are killed and starved, and what must hold of what they leave."""
