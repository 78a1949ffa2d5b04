//! Numbers that begin at a cache line: registers that straddle two lines take twice as long to load.

use std::ops::{Deref, DerefMut};

/// The bytes of a cache line.
const LINE_BYTES: usize = 64;

/// The numbers in a cache line.
const LINE: usize = LINE_BYTES / size_of::<f64>();

/// Numbers of which the first begins a cache line.
#[derive(Debug, Default)]
pub struct Aligned {
    /// Up to a line more than there are.
    room: Vec<f64>,
    first: usize,
    n: usize,
}

impl Aligned {
    /// Returns `n` zeros.
    pub fn zeros(n: usize) -> Self {
        let room = vec![0.0; n + LINE];
        // The offset is a hint: whatever it is, it only decides how fast the numbers are.
        let first = room.as_ptr().align_offset(LINE_BYTES).min(LINE);
        Self { room, first, n }
    }

    /// Makes it `n` numbers, of which it does not matter what they are.
    #[inline(always)]
    pub fn make_room(&mut self, n: usize) {
        if self.first + n > self.room.len() {
            *self = Self::zeros(n);
        }
        self.n = n;
    }
}

impl Clone for Aligned {
    fn clone(&self) -> Self {
        let mut copy = Self::zeros(self.n);
        copy.copy_from_slice(self);
        copy
    }
}

impl Deref for Aligned {
    type Target = [f64];

    #[inline(always)]
    fn deref(&self) -> &[f64] {
        &self.room[self.first..self.first + self.n]
    }
}

impl DerefMut for Aligned {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [f64] {
        &mut self.room[self.first..self.first + self.n]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_begin_at_a_line_and_are_kept_in_copies() {
        for n in [0, 1, 7, 8, 1000] {
            let mut numbers = Aligned::zeros(n);
            assert_eq!(numbers.len(), n);
            assert_eq!(numbers.as_ptr().align_offset(LINE_BYTES), 0);
            numbers.fill(2.0);
            assert_eq!(*numbers.clone(), *numbers);
            numbers.make_room(n + 100);
            assert_eq!(numbers.len(), n + 100);
            assert_eq!(numbers.as_ptr().align_offset(LINE_BYTES), 0);
        }
    }
}
