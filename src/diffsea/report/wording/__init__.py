"""What results say to people: words, sentences and the lines of a terminal."""
