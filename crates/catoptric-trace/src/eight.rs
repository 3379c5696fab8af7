//! Eight numbers at a time: AVX2 where the machine has it, otherwise two `glam::Vec4` (SSE2 on x86-64, NEON, or scalar).
//! Both round alike, so every ray meets the same on every machine.

use glam::Vec4;

/// Eight numbers in memory, aligned so that one load takes them.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(crate) struct Row(pub(crate) [f32; 8]);

/// An instruction set for eight numbers.
pub(crate) trait Eight: Copy {
    /// Eight numbers in registers.
    type Numbers: Copy;

    /// Runs `work` with the instructions; whatever is inlined into it uses them too.
    fn run<R>(self, work: impl FnOnce() -> R) -> R;
    fn splat(self, value: f32) -> Self::Numbers;
    fn load(self, row: &Row) -> Self::Numbers;
    fn store(self, numbers: Self::Numbers) -> [f32; 8];
    fn add(self, a: Self::Numbers, b: Self::Numbers) -> Self::Numbers;
    fn subtract(self, a: Self::Numbers, b: Self::Numbers) -> Self::Numbers;
    fn multiply(self, a: Self::Numbers, b: Self::Numbers) -> Self::Numbers;
    /// `b` where either is NaN.
    fn min(self, a: Self::Numbers, b: Self::Numbers) -> Self::Numbers;
    /// `b` where either is NaN.
    fn max(self, a: Self::Numbers, b: Self::Numbers) -> Self::Numbers;
    /// Bit per lane with a ≤ b.
    fn at_most(self, a: Self::Numbers, b: Self::Numbers) -> u32;
}

/// The instructions that this machine has.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) enum Level {
    /// What every machine has.
    #[default]
    Plain,
    /// AVX2.
    #[cfg(target_arch = "x86_64")]
    Avx2(pulp::x86::V3),
}

impl Level {
    /// The best of this machine.
    pub(crate) fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if let Some(instructions) = pulp::x86::V3::try_new() {
            return Self::Avx2(instructions);
        }
        Self::Plain
    }
}

/// Runs an expression with the instructions of a level under the name given.
macro_rules! at_level {
    ($level:expr, $name:ident => $work:expr) => {
        match $level {
            $crate::eight::Level::Plain => {
                let $name = $crate::eight::Plain;
                $work
            }
            #[cfg(target_arch = "x86_64")]
            $crate::eight::Level::Avx2($name) => $crate::eight::Eight::run(
                $name,
                #[inline(always)]
                || $work,
            ),
        }
    };
}
pub(crate) use at_level;

/// Two vectors of four.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plain;

impl Eight for Plain {
    type Numbers = [Vec4; 2];

    #[inline(always)]
    fn run<R>(self, work: impl FnOnce() -> R) -> R {
        work()
    }

    #[inline(always)]
    fn splat(self, value: f32) -> [Vec4; 2] {
        [Vec4::splat(value); 2]
    }

    #[inline(always)]
    fn load(self, row: &Row) -> [Vec4; 2] {
        [Vec4::from_slice(&row.0[..4]), Vec4::from_slice(&row.0[4..])]
    }

    #[inline(always)]
    fn store(self, [a, b]: [Vec4; 2]) -> [f32; 8] {
        let [a, b] = [a.to_array(), b.to_array()];
        [a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3]]
    }

    #[inline(always)]
    fn add(self, a: [Vec4; 2], b: [Vec4; 2]) -> [Vec4; 2] {
        [a[0] + b[0], a[1] + b[1]]
    }

    #[inline(always)]
    fn subtract(self, a: [Vec4; 2], b: [Vec4; 2]) -> [Vec4; 2] {
        [a[0] - b[0], a[1] - b[1]]
    }

    #[inline(always)]
    fn multiply(self, a: [Vec4; 2], b: [Vec4; 2]) -> [Vec4; 2] {
        [a[0] * b[0], a[1] * b[1]]
    }

    #[inline(always)]
    fn min(self, a: [Vec4; 2], b: [Vec4; 2]) -> [Vec4; 2] {
        [a[0].min(b[0]), a[1].min(b[1])]
    }

    #[inline(always)]
    fn max(self, a: [Vec4; 2], b: [Vec4; 2]) -> [Vec4; 2] {
        [a[0].max(b[0]), a[1].max(b[1])]
    }

    #[inline(always)]
    fn at_most(self, a: [Vec4; 2], b: [Vec4; 2]) -> u32 {
        a[0].cmple(b[0]).bitmask() | a[1].cmple(b[1]).bitmask() << 4
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use pulp::x86::V3;
    use pulp::{Simd, cast, f32x8};

    use super::{Eight, Row};

    impl Eight for V3 {
        type Numbers = f32x8;

        #[inline(always)]
        fn run<R>(self, work: impl FnOnce() -> R) -> R {
            self.vectorize(work)
        }

        #[inline(always)]
        fn splat(self, value: f32) -> f32x8 {
            self.splat_f32s(value)
        }

        #[inline(always)]
        fn load(self, row: &Row) -> f32x8 {
            cast(row.0)
        }

        #[inline(always)]
        fn store(self, numbers: f32x8) -> [f32; 8] {
            cast(numbers)
        }

        #[inline(always)]
        fn add(self, a: f32x8, b: f32x8) -> f32x8 {
            self.add_f32s(a, b)
        }

        #[inline(always)]
        fn subtract(self, a: f32x8, b: f32x8) -> f32x8 {
            self.sub_f32s(a, b)
        }

        #[inline(always)]
        fn multiply(self, a: f32x8, b: f32x8) -> f32x8 {
            self.mul_f32s(a, b)
        }

        #[inline(always)]
        fn min(self, a: f32x8, b: f32x8) -> f32x8 {
            self.min_f32s(a, b)
        }

        #[inline(always)]
        fn max(self, a: f32x8, b: f32x8) -> f32x8 {
            self.max_f32s(a, b)
        }

        #[inline(always)]
        fn at_most(self, a: f32x8, b: f32x8) -> u32 {
            self.avx._mm256_movemask_ps(cast(self.less_than_or_equal_f32s(a, b))) as u32
        }
    }
}
