"""The steps one after another: amplifiers, rigid rotor, flexible modes; where joint fits start, and a comparison."""
