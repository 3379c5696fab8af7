//! Which things hang together (union–find).

/// Sets of 0..n, joined step by step; the least member names a set.
#[derive(Clone, Debug)]
pub struct Union {
    parent: Vec<u32>,
}

impl Union {
    /// Each alone.
    pub fn new(count: usize) -> Self {
        Self { parent: (0..count as u32).collect() }
    }

    /// The least member of a set.
    pub fn find(&mut self, mut of: u32) -> u32 {
        while self.parent[of as usize] != of {
            let above = self.parent[self.parent[of as usize] as usize];
            self.parent[of as usize] = above;
            of = above;
        }
        of
    }

    /// Makes two sets one.
    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }

    /// The number of each member's set, counted from zero, and how many there are.
    pub fn numbered(mut self) -> (Vec<u32>, usize) {
        let mut number = vec![u32::MAX; self.parent.len()];
        let mut sets = 0;
        for member in 0..self.parent.len() as u32 {
            let first = self.find(member) as usize;
            if number[first] == u32::MAX {
                number[first] = sets;
                sets += 1;
            }
            number[member as usize] = number[first];
        }
        (number, sets as usize)
    }
}
