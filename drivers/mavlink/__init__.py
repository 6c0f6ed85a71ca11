"""MAVLink vehicles, through pymavlink's dialect codec over our own transport."""
