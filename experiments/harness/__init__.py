"""What experiments share: options, results, tables and figures; real runs; memory."""
