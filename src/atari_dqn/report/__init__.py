"""The written report: figures, tables, videos, and what binds them."""
