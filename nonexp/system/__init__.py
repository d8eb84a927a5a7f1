"""What stands below all: this machine, files, signals, the terminal. No rendering here."""
