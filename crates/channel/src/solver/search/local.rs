//! Local search: single moves, swaps and pairs of moves.

use super::{MOVE_PASSES_MAX, Search};
use crate::solver::table::{Table, Utility};

/// Largest number of rounds of swaps to a local optimum.
const EXCHANGE_ROUNDS_MAX: usize = 20;
/// Largest number of rounds of pairs of moves.
const PAIR_ROUNDS_MAX: usize = 3;

impl Search {
    /// At most `passes` passes of single moves on `trial`, until no mirror moves.
    pub(super) fn move_passes(&mut self, table: &Table, utility: &Utility, passes: usize) {
        self.trial.move_each(table, utility, passes);
        self.trial.settle(table, utility);
    }

    /// Moves and swaps until `trial` is a local optimum.
    pub(super) fn refine(&mut self, table: &Table, utility: &Utility) {
        for _ in 0..EXCHANGE_ROUNDS_MAX {
            self.move_passes(table, utility, MOVE_PASSES_MAX);
            if !self.trial.swap_pairs(table, utility, &mut self.scratch) {
                break;
            }
        }
        self.trial.settle(table, utility);
    }

    /// Pairs of moves on `trial`, each round followed by single moves and swaps.
    ///
    /// At the kink of a minimum rate, single moves and swaps stop at points that are not local
    /// optima of pairs.
    pub(super) fn move_pairs(&mut self, table: &Table, utility: &Utility) {
        for _ in 0..PAIR_ROUNDS_MAX {
            if !self.trial.move_pairs(table, utility, &mut self.scratch) {
                break;
            }
            self.refine(table, utility);
        }
    }

    /// Forces each single move on `best` and continues with swaps and pairs, which combines three
    /// and more moves.
    ///
    /// For small problems.
    pub(super) fn force_moves(&mut self, table: &Table, utility: &Utility) {
        for _ in 0..PAIR_ROUNDS_MAX {
            let before = self.best.nats;
            for &m in &table.useful {
                for user in 0..table.users {
                    self.trial.copy_from(&self.best);
                    self.trial.served[m] = user;
                    self.trial.settle(table, utility);
                    // Swaps and pairs first, since a single move would undo the forced one.
                    self.trial.swap_pairs(table, utility, &mut self.scratch);
                    self.move_pairs(table, utility);
                    self.keep_better();
                }
            }
            if self.best.nats <= before {
                break;
            }
        }
    }
}
