// Jain's fairness index of rates: (sum r)^2 / (n sum r^2). It is 1 where all rates are equal, and 1/n where
// one user has everything. `null` without rates, while one is unknown, and where all are 0: the index is 0 / 0
// there, as in `heliostat-lab eval`. Source: Jain, Chiu and Hawe, DEC-TR-301, 1984.
export function jain(rates) {
  if (rates.includes(null)) return null;
  const sum = rates.reduce((total, rate) => total + rate, 0);
  const squares = rates.reduce((total, rate) => total + rate * rate, 0);
  return squares === 0 ? null : (sum * sum) / (rates.length * squares);
}
