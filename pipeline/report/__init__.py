"""The report of one loop: its data, its charts and its page, in one HTML file that needs no network."""
