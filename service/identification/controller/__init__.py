"""Whether a control law is safe on an identified rotor, before it is loaded: at standstill and at speed."""
