"""The console's feeds: data that pages watch."""
