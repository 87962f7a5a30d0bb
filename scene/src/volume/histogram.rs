//! How often which values occur, and where a surface may be.

use rt_core::volume::{Volume, VolumeTable};

use super::error::VolumeError;
use super::stored::SampleRange;
use super::{ValueMap, VolumeSource};

/// Counts of a volume's samples in bins of one width.
///
/// Samples that are NaN or infinite are in no bin. Bins of whole numbers hold as many of them each and end halfway
/// between two.
#[derive(Clone, Debug)]
pub struct Histogram {
    counts: Vec<u64>,
    /// Where the first bin begins, and how wide each is; in samples.
    bins: ValueMap,
    /// Makes values of samples.
    world: ValueMap,
    range: Option<SampleRange>,
    absent: u64,
    sum: f64,
}

impl Histogram {
    /// Counts every sample in at most `bins_max` bins. Reads the volume once when its samples are whole numbers of at
    /// most 16 bits, else twice.
    ///
    /// # Errors
    /// When the volume cannot be read.
    ///
    /// # Panics
    /// When `bins_max` is 0.
    pub fn of(source: &mut dyn VolumeSource, bins_max: usize) -> Result<Self, VolumeError> {
        assert!(bins_max > 0, "a histogram has a bin");
        match source.shape().sample.narrow_range() {
            Some(range) => Self::of_narrow(source, bins_max, range),
            None => Self::of_wide(source, bins_max),
        }
    }

    /// The counts that stand in the table of a scene image; `None` when these are not the bytes of one.
    pub fn of_image(volume: &Volume, table: &[u8]) -> Option<Self> {
        let table: VolumeTable = bytemuck::try_pod_read_unaligned(table).ok()?;
        let [low, high] = [table.histogram_low, table.histogram_high].map(f64::from);
        let counts = table.histogram.to_vec();
        let bins = ValueMap { slope: (high - low) / counts.len() as f64, intercept: low };
        let world = ValueMap { slope: volume.slope, intercept: volume.intercept };
        let range = SampleRange { low: volume.low, high: volume.high, is_finite: table.absent == 0 };
        let middle = |(bin, count): (usize, &u64)| bins.apply(bin as f64 + 0.5) * *count as f64;
        let sum = counts.iter().enumerate().map(middle).sum();
        Some(Self { counts, bins, world, range: Some(range), absent: table.absent, sum })
    }

    /// Counts every number the type has, then joins them to bins.
    fn of_narrow(
        source: &mut dyn VolumeSource,
        bins_max: usize,
        [lowest, highest]: [i32; 2],
    ) -> Result<Self, VolumeError> {
        let mut table = vec![0_u64; usize::try_from(highest - lowest).unwrap_or_default() + 1];
        for_each_run(source, |samples| {
            for sample in samples {
                #[expect(clippy::cast_possible_truncation, reason = "a whole number of at most 16 bits")]
                let place = usize::try_from(*sample as i32 - lowest).unwrap_or_default();
                table[place] += 1;
            }
        })?;
        let numbers = || (lowest..=highest).zip(&table).filter(|(_, count)| **count > 0);
        let single = |number: i32| number as f32;
        let range = numbers().next().zip(numbers().last()).map(|((low, _), (high, _))| SampleRange {
            low: single(low),
            high: single(high),
            is_finite: true,
        });
        let mut histogram = Self::empty(source, bins_max, range, 0);
        for (number, count) in numbers() {
            histogram.add(f64::from(number), *count);
        }
        Ok(histogram)
    }

    /// Finds the range first.
    fn of_wide(source: &mut dyn VolumeSource, bins_max: usize) -> Result<Self, VolumeError> {
        let (mut low, mut high, mut absent) = (f32::INFINITY, f32::NEG_INFINITY, 0);
        for_each_run(source, |samples| {
            for sample in samples {
                if sample.is_finite() {
                    (low, high) = (low.min(*sample), high.max(*sample));
                } else {
                    absent += 1;
                }
            }
        })?;
        let range = (low <= high).then_some(SampleRange { low, high, is_finite: absent == 0 });
        let mut histogram = Self::empty(source, bins_max, range, absent);
        if range.is_some() {
            for_each_run(source, |samples| {
                for sample in samples.iter().filter(|sample| sample.is_finite()) {
                    histogram.add(f64::from(*sample), 1);
                }
            })?;
        }
        Ok(histogram)
    }

    /// Bins for samples of a range, nothing in them.
    fn empty(source: &dyn VolumeSource, bins_max: usize, range: Option<SampleRange>, absent: u64) -> Self {
        let [low, high] = range.map_or([0.0; 2], |range| [range.low, range.high].map(f64::from));
        let (width, count) = if source.shape().sample.is_whole() {
            let numbers = high - low + 1.0;
            let width = (numbers / bins_max as f64).ceil();
            (width, numbers / width)
        } else if high > low {
            ((high - low) / bins_max as f64, bins_max as f64)
        } else {
            (1.0, 1.0)
        };
        let intercept = if source.shape().sample.is_whole() || high == low { low - 0.5 } else { low };
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most `bins_max`")]
        let counts = vec![0; count.ceil() as usize];
        let bins = ValueMap { slope: width, intercept };
        Self { counts, bins, world: source.shape().world, range, absent, sum: 0.0 }
    }

    fn add(&mut self, sample: f64, count: u64) {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "cut to the bins there are"
        )]
        let bin = (self.bins.invert(sample) as usize).min(self.counts.len() - 1);
        self.counts[bin] += count;
        self.sum += sample * count as f64;
    }

    /// An isovalue between what is frequent below and what is frequent above: the one that parts the samples into two
    /// classes with the most variance between them. `None` when all samples are the same, which have no surface.
    ///
    /// # Source
    /// Otsu, "A threshold selection method from gray-level histograms", IEEE Transactions on Systems, Man, and
    /// Cybernetics 9(1), 1979. Of bins between which nothing changes, the middle is taken.
    pub fn auto_isovalue(&self) -> Option<f64> {
        let total = self.total() as f64;
        let moments = |(count, bin): (&u64, usize)| (*count as f64, *count as f64 * (bin as f64 + 0.5));
        let mean = self.counts.iter().zip(0..).map(|bin| moments(bin).1).sum::<f64>() / total;
        let (mut below, mut below_sum) = (0.0, 0.0);
        // The highest variance, and the first and last place where it is reached.
        let mut best: (f64, usize, usize) = (0.0, 0, 0);
        for (count, bin) in self.counts.iter().zip(0..) {
            let (count, sum) = moments((count, bin));
            (below, below_sum) = (below + count, below_sum + sum);
            let above = total - below;
            if below > 0.0 && above > 0.0 {
                let distance = mean * below - below_sum;
                let variance = distance * distance / (below * above);
                if variance > best.0 {
                    best = (variance, bin, bin);
                } else if variance == best.0 && count == 0.0 {
                    best.2 = bin;
                }
            }
        }
        let (variance, first, last) = best;
        let place = (first + last) as f64 / 2.0 + 1.0;
        (variance > 0.0).then(|| self.world.apply(self.bins.apply(place)))
    }

    /// Number of samples in each bin.
    pub fn counts(&self) -> &[u64] {
        &self.counts
    }

    /// Where a bin begins and ends, as values; the lower first when the volume's slope is positive.
    pub fn bin(&self, bin: usize) -> [f64; 2] {
        [bin, bin + 1].map(|place| self.world.apply(self.bins.apply(place as f64)))
    }

    /// Lowest and highest finite sample; `None` when there is none.
    pub const fn range(&self) -> Option<&SampleRange> {
        self.range.as_ref()
    }

    /// Lowest and highest value; `None` when no sample is finite.
    pub fn values(&self) -> Option<[f64; 2]> {
        let ends =
            self.range.map(|range| [range.low, range.high].map(|sample| self.world.apply(f64::from(sample))));
        ends.map(|[a, b]| [a.min(b), a.max(b)])
    }

    /// Mean of all values; `None` when no sample is finite.
    pub fn mean(&self) -> Option<f64> {
        (self.total() > 0).then(|| self.world.apply(self.sum / self.total() as f64))
    }

    /// Number of samples that are NaN or infinite.
    pub const fn absent(&self) -> u64 {
        self.absent
    }

    /// Number of samples in the bins.
    fn total(&self) -> u64 {
        self.counts.iter().sum()
    }
}

/// Hands out every sample of a volume, run by run.
fn for_each_run(source: &mut dyn VolumeSource, mut take: impl FnMut(&[f32])) -> Result<(), VolumeError> {
    let total = source.shape().samples();
    let slice = source.shape().slice_samples();
    // Whole slices where that is little, since some volumes are faster so.
    let run = if slice <= RUN_SAMPLES { slice * (RUN_SAMPLES / slice) } else { RUN_SAMPLES };
    let mut samples = vec![0.0; usize::try_from(run.min(total)).unwrap_or(usize::MAX)];
    let mut first = 0;
    while first < total {
        let count = usize::try_from(total - first).unwrap_or(usize::MAX).min(samples.len());
        source.read_samples(first, &mut samples[..count])?;
        take(&samples[..count]);
        first += count as u64;
    }
    Ok(())
}

/// Samples of a run, 2 MB of them.
const RUN_SAMPLES: u64 = 1 << 19;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::{Analytic, Formula, SampleType, VolumeShape, run};

    /// A volume in memory.
    struct Given {
        shape: VolumeShape,
        samples: Vec<f32>,
    }

    impl VolumeSource for Given {
        fn shape(&self) -> &VolumeShape {
            &self.shape
        }

        fn read_samples(&mut self, first: u64, samples: &mut [f32]) -> Result<(), VolumeError> {
            samples.copy_from_slice(&self.samples[run::index(first)..][..samples.len()]);
            Ok(())
        }
    }

    fn given(sample: SampleType, samples: &[f32]) -> Given {
        let shape = VolumeShape::new([samples.len() as u64, 1, 1], sample).expect("small");
        Given { shape, samples: samples.to_vec() }
    }

    fn histogram(sample: SampleType, samples: &[f32], bins: usize) -> Histogram {
        Histogram::of(&mut given(sample, samples), bins).expect("in memory")
    }

    #[test]
    fn whole_numbers_share_bins_evenly() {
        for sample in [SampleType::U8, SampleType::I16, SampleType::I32] {
            let bytes: Vec<f32> = (0..=100_u8).map(f32::from).collect();
            let each = histogram(sample, &bytes, 256);
            assert_eq!((each.counts(), each.bin(100)), (vec![1; 101].as_slice(), [99.5, 100.5]), "{sample}");
            let tens = histogram(sample, &bytes, 11);
            assert_eq!(
                (tens.counts().len(), tens.counts()[10], tens.bin(10)),
                (11, 1, [99.5, 109.5]),
                "{sample}"
            );
            assert_eq!((tens.values(), tens.mean(), tens.absent()), (Some([0.0, 100.0]), Some(50.0), 0));
        }
    }

    #[test]
    fn what_is_not_finite_is_counted_apart() {
        let samples = [f32::NAN, 1.0, f32::INFINITY, 3.0, f32::NEG_INFINITY, 2.5];
        let some = histogram(SampleType::F32, &samples, 4);
        assert_eq!((some.counts(), some.absent()), ([1, 0, 0, 2].as_slice(), 3));
        assert_eq!(some.range(), Some(&SampleRange { low: 1.0, high: 3.0, is_finite: false }));
        let none = histogram(SampleType::F32, &[f32::NAN; 3], 4);
        assert_eq!((none.values(), none.mean(), none.auto_isovalue()), (None, None, None));
    }

    #[test]
    fn values_of_any_size_have_a_bin() {
        let samples = [-3.0e38, 1.0e-30, 3.0e38];
        let wide = histogram(SampleType::F32, &samples, 1024);
        assert_eq!((wide.counts()[0], wide.counts()[512], wide.counts()[1023]), (1, 1, 1));
        let flat = histogram(SampleType::F32, &[1.0e30; 5], 1024);
        assert_eq!((flat.counts(), flat.auto_isovalue()), ([5].as_slice(), None));
        assert_eq!(histogram(SampleType::U8, &[7.0; 5], 256).auto_isovalue(), None);
    }

    #[test]
    fn the_isovalue_is_halfway_between_two_values() {
        let mut source = given(SampleType::U8, &[10.0, 10.0, 10.0, 200.0]);
        let isovalue = |source: &mut Given| Histogram::of(source, 256).expect("in memory").auto_isovalue();
        assert_eq!(isovalue(&mut source), Some(105.0));
        source.shape.world = ValueMap { slope: -2.0, intercept: 1.0 };
        assert_eq!(isovalue(&mut source), Some(-209.0));
    }

    #[test]
    fn a_volume_of_several_runs_is_counted_whole() {
        let mut source = Analytic::new(Formula::MarschnerLobb, 90).expect("a size");
        let histogram = Histogram::of(&mut source, 256).expect("no file");
        assert_eq!(histogram.counts().iter().sum::<u64>(), 90 * 90 * 90);
        let isovalue = histogram.auto_isovalue().expect("a surface");
        assert!((0.3..0.6).contains(&isovalue), "{isovalue}");
    }
}
