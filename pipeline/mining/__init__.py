"""What went wrong and what to correct first: failures described, grouped, and put in order of their worth."""
