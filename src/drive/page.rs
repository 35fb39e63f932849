//! The report: one page of HTML with everything in it.

use std::fmt::Write as _;

use super::study::{HEADER, Outcome, Study, remarks, row};
use crate::profile::html::{STYLE, escaped, table};

/// Ways of so many cases are drawn at most.
pub(super) const MOST_PATHS: usize = 12;

const MEANING: &str = "Errors are distances of the true rear axle from the path. A drive ends at the first touch of a wall, or when the car \
    has not come on for 10 s. Pose: RMS distance of the poses from the truth at their stamps. Late: answers later than their contract; with no contract, than the next scan. Age: of the pose when the \
    command acts, mean. cpu/lap: processor time of the estimator, other programs' apart.";

/// The page, with pictures and their titles.
pub(super) fn report(study: &Study, outcomes: &[Outcome], pictures: &[(String, String)]) -> String {
    let fact = |(name, value): &(&str, String)| format!("<tr><td>{name}</td><td>{}</td></tr>\n", escaped(value));
    let facts = study.facts().iter().map(fact).collect::<Vec<_>>().concat();
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width\">\n\
         <title>Drives in {0}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<h1>The closed loop: drives in {0}</h1>\n<pre>{1}</pre>\n\
         <table class=\"facts\">\n{facts}</table>\n<h2>Figures</h2>\n{2}{3}<p>{MEANING}</p>\n",
        escaped(&study.course.name),
        escaped(&study.command),
        table(&HEADER, outcomes.iter().map(row)),
        remarks(outcomes).iter().fold(String::new(), |text, remark| text + "<p>" + &escaped(remark) + "</p>\n"),
    );
    for (title, svg) in pictures {
        let _ = write!(page, "<h2>{}</h2>\n<figure>\n{svg}</figure>\n", escaped(title));
    }
    page + "</body>\n</html>\n"
}
