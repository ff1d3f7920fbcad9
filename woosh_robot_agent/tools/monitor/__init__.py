"""The program `monitor`: shows the state of one robot in the terminal."""
