"""The closed loop of an identified plane and its controller: its poles, its sensitivity, its margins."""
