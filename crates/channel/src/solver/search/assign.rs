//! One step of the fixed point: the assignment by weights, and its amplitudes.

use super::Search;
use crate::simd::with_widest_simd;
use crate::solver::table::Table;

/// Number of mirrors that one loop assigns together.
const OWNED_AT_ONCE: usize = 8;

impl Search {
    /// Assigns each mirror to the allowed user with the largest weighted gain, and sums the
    /// amplitudes.
    ///
    /// Selections instead of branches, and few mirrors at a time, so that the compiler keeps them
    /// in SIMD registers.
    pub(super) fn assign(&mut self, table: &Table) {
        for (effective, (&weight, &allowed)) in self.effective.iter_mut().zip(self.weights.iter().zip(&self.allowed)) {
            *effective = if allowed { weight } else { 0.0 };
        }
        with_widest_simd(
            #[inline(always)]
            || {
                let (blocks, rest) = self.owners.as_chunks_mut::<OWNED_AT_ONCE>();
                let done = blocks.len() * OWNED_AT_ONCE;
                for (block, owners) in blocks.iter_mut().enumerate() {
                    *owners = strongest(&self.effective, table, block * OWNED_AT_ONCE);
                }
                for (index, owner) in rest.iter_mut().enumerate() {
                    [*owner] = strongest(&self.effective, table, done + index);
                }
                if !table.spill.is_empty() {
                    self.share(table);
                }
                for (k, line) in table.by_user.chunks_exact(table.mirrors).enumerate() {
                    self.amplitude[k] = table.los_amplitude[k] + owned_sum(line, &self.owners, k as f64);
                }
                if !table.spill.is_empty() {
                    for (m, owner) in self.owners.iter().enumerate() {
                        for &(k, gain) in table.spill.of(*owner as usize, m) {
                            self.amplitude[k] += gain;
                        }
                    }
                }
            },
        );
    }

    /// Assigns each mirror that reaches several users at once to the aim with the largest weighted
    /// sum of gains, instead of the user with the largest weighted gain.
    #[inline(always)]
    fn share(&mut self, table: &Table) {
        for (m, owner) in self.owners.iter_mut().enumerate().filter(|(m, _)| table.spill.shares(*m)) {
            let strongest = *owner as usize;
            let (mut best, mut most) = (strongest, self.effective[strongest] * table.line(m)[strongest]);
            for &aim in table.spill.aims_of(m).iter().filter(|aim| table.spill.is_allowed(**aim, &self.allowed)) {
                let worth: f64 = table.aim(m, aim).map(|(user, gain)| self.effective[user] * gain).sum();
                if worth > most || worth == most && aim < best {
                    (best, most) = (aim, worth);
                }
            }
            *owner = best as f64;
        }
    }
}

/// The user with the largest weighted gain of each of `N` mirrors from an index on; user 0 where
/// all gains are 0.
#[inline(always)]
fn strongest<const N: usize>(weights: &[f64], table: &Table, first: usize) -> [f64; N] {
    let (mut most, mut owners) = ([0.0; N], [0.0; N]);
    for (k, &weight) in weights.iter().enumerate() {
        let start = k * table.mirrors + first;
        let Some(gains) = table.by_user[start..].first_chunk::<N>() else { break };
        for lane in 0..N {
            let worth = weight * gains[lane];
            let better = worth > most[lane];
            most[lane] = if better { worth } else { most[lane] };
            owners[lane] = if better { k as f64 } else { owners[lane] };
        }
    }
    owners
}

/// Sum of the gains of a user's mirrors, in four independent sums so that the additions overlap.
#[inline(always)]
fn owned_sum(line: &[f64], owners: &[f64], user: f64) -> f64 {
    let mut sums = [0.0; 4];
    let (lines, rest) = line.as_chunks::<4>();
    let (owner_lines, owner_rest) = owners.as_chunks::<4>();
    for (gains, owners) in lines.iter().zip(owner_lines) {
        for lane in 0..4 {
            sums[lane] += if owners[lane] == user { gains[lane] } else { 0.0 };
        }
    }
    let tail: f64 = rest.iter().zip(owner_rest).map(|(&gain, &owner)| if owner == user { gain } else { 0.0 }).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + tail
}
