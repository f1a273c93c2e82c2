"""What vessels know of each other: AIS, who follows whom, and how near they came."""
