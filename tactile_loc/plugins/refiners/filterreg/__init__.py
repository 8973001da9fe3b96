"""The FilterReg refiner."""
