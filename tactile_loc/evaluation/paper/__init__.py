"""The protocol of the paper: its measurements from one touch and from several contacts, and its tables."""
