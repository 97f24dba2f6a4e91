//! The functions that sum adjoints of the scene's numbers, and write the sums.

use crate::error::{Error, Result};
use crate::program::rewrite::function_builder::{FunctionBuilder, real_literal};
use crate::program::rewrite::transpose::emit::Emitter;
use crate::program::rewrite::transpose::layout::{Layout, add_chains, bound};
use crate::program::rewrite::transpose::names::{CUT_LOOPS, LOST};
use crate::program::rewrite::transpose::transposer::Transposer;
use naga::{
    AddressSpace, ArraySize, BinaryOperator, Block, Expression, Function, GlobalVariable, Handle, Literal,
    Span, Statement, TypeInner,
};

impl Transposer<'_> {
    /// The variable that sums one invocation's adjoints: of the numbers, then of the total flux.
    fn sums_variable(&mut self, layout: &Layout) -> Result<Handle<GlobalVariable>> {
        const NAME: &str = "sums_of_adjoints";
        let is_known = |variable: &GlobalVariable| variable.name.as_deref() == Some(NAME);
        let known = self.rewriting.new.global_variables.iter().find(|(_, variable)| is_known(variable));
        if let Some(handle) = known.map(|(handle, _)| handle) {
            return Ok(handle);
        }
        let real = self.rewriting.real;
        let base = self.type_with(TypeInner::Scalar(real));
        let num = std::num::NonZeroU32::new(layout.num_numbers() as u32 + 1);
        let num = num.ok_or_else(|| Error::Internal("no sums of adjoints".into()))?;
        let size = ArraySize::Constant(num);
        let ty = self.type_with(TypeInner::Array { base, size, stride: u32::from(real.width) });
        let variable = GlobalVariable {
            name: Some(NAME.into()),
            space: AddressSpace::Private,
            ty,
            binding: None,
            init: None,
            memory_decorations: Default::default(),
        };
        Ok(self.rewriting.new.global_variables.append(variable, Span::UNDEFINED))
    }

    /// The function `ADD_UP`.
    pub(super) fn add_up(&mut self, old: &Function, layout: &Layout) -> Result<Function> {
        let sums = self.sums_variable(layout)?;
        let module = self.module;
        let real = self.rewriting.real;
        let is_number = self.rewriting.plain("is_number")?;
        let noted = self.global("noted")?;
        let real_type = module.global_variables[noted].ty;
        let mut twins: Vec<_> = bound(module).collect();
        twins.sort_unstable_by_key(|(binding, _)| *binding);
        let mut writer = Emitter::of(old);
        let mut values = Vec::new();
        for (_, (handle, variable)) in twins {
            let Some(twin) = self.twins.get(&handle) else { continue };
            let mut chains = Vec::new();
            add_chains(module, variable.ty, real, &mut Vec::new(), &mut chains);
            let twin = writer.append(Expression::GlobalVariable(*twin));
            for chain in chains {
                let pointer = chain
                    .into_iter()
                    .fold(twin, |base, index| writer.now(Expression::AccessIndex { base, index }));
                values.push(writer.now(Expression::Load { pointer }));
            }
        }
        let noted = writer.append(Expression::GlobalVariable(noted));
        values.push(writer.now(Expression::Load { pointer: noted }));
        // One number that is none makes the sum of all no number. Summed in pairs, because texts nest only so deep.
        let mut sums_of_pairs = values.clone();
        while sums_of_pairs.len() > 1 {
            let pair = |pair: &[Handle<Expression>]| match *pair {
                [left, right] => writer.now(Expression::Binary { op: BinaryOperator::Add, left, right }),
                _ => pair[0],
            };
            sums_of_pairs = sums_of_pairs.chunks(2).map(pair).collect();
        }
        let total = sums_of_pairs[0];
        let condition = writer.call_now(is_number, vec![total]);
        let sums = writer.append(Expression::GlobalVariable(sums));
        let lost = writer.append(Expression::GlobalVariable(self.global(LOST)?));
        let add = |writer: &mut Emitter,
                   pointer: Handle<Expression>,
                   value: Handle<Expression>,
                   out: &mut Block| {
            let before = writer.emit(Expression::Load { pointer }, out);
            let value = writer.binary(BinaryOperator::Add, before, value, out);
            out.push(Statement::Store { pointer, value }, Span::UNDEFINED);
        };
        let (mut accept, mut reject) = (Block::new(), Block::new());
        for (index, value) in values.iter().enumerate() {
            let sum = writer.emit(Expression::AccessIndex { base: sums, index: index as u32 }, &mut accept);
            add(&mut writer, sum, *value, &mut accept);
        }
        let one = writer.append(real_literal(real, 1.0));
        add(&mut writer, lost, one, &mut reject);
        writer.body.push(Statement::If { condition, accept, reject }, Span::UNDEFINED);
        let mut zeroed: Vec<_> =
            self.twins.iter().map(|(old, twin)| (*twin, module.global_variables[*old].ty)).collect();
        zeroed.sort_unstable_by_key(|(twin, _)| twin.index());
        for (twin, ty) in zeroed {
            let pointer = writer.append(Expression::GlobalVariable(twin));
            let value = writer.append(Expression::ZeroValue(ty));
            writer.store(pointer, value);
        }
        let value = writer.append(Expression::ZeroValue(real_type));
        writer.store(noted, value);
        Ok(writer.finished())
    }

    /// The function `WRITE`.
    pub(super) fn write_sums(&mut self, old: &Function, layout: &Layout) -> Result<Function> {
        let sums = self.sums_variable(layout)?;
        let rows = self.global("adjoint_sums")?;
        let mut writer = Emitter::of(old);
        let [sums, rows] = [sums, rows].map(|variable| writer.append(Expression::GlobalVariable(variable)));
        let invocation = writer.append(Expression::FunctionArgument(0));
        let literal = |writer: &mut Emitter, value: usize| {
            writer.append(Expression::Literal(Literal::U32(value as u32)))
        };
        let num = literal(&mut writer, layout.num_sums());
        let first =
            writer.now(Expression::Binary { op: BinaryOperator::Multiply, left: invocation, right: num });
        let [lost, cut_loops] = [self.global(LOST)?, self.global(CUT_LOOPS)?]
            .map(|variable| writer.append(Expression::GlobalVariable(variable)));
        let num = layout.num_sums();
        for index in 0..num {
            let offset = literal(&mut writer, index);
            let place =
                writer.now(Expression::Binary { op: BinaryOperator::Add, left: first, right: offset });
            let to = writer.now(Expression::Access { base: rows, index: place });
            let from = match num - index {
                1 => cut_loops,
                2 => lost,
                _ => writer.now(Expression::AccessIndex { base: sums, index: index as u32 }),
            };
            let value = writer.now(Expression::Load { pointer: from });
            writer.store(to, value);
        }
        Ok(writer.finished())
    }
}
