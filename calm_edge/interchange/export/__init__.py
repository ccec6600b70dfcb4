"""Files written for other programs: a format a file, and what they share."""
