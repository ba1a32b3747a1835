"""Sources and file formats: readers and writers, one format a file."""
