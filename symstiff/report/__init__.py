"""Reports: tables, pictures, HTML."""
