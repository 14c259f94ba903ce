"""What averages alone do not mend: outliers, noise that was cut off, shared or coded by JPEG, the mean light."""
