"""The kinds of logs. Each yields blocks of rows (rows.py), and says what is wrong with a log and where."""
