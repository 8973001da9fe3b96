"""What a visitor sees: tabs, controls, pictures and notices."""
