# Figures of R for data sets that come with it and with its packages, for tests/analysis/
# test_r_datasets.py.
#   Rscript r_datasets.R > r_datasets.csv        (in this folder; lme4, pbkrtest, MASS)
#   Rscript r_datasets.R rows FOLDER             (the rows themselves, which stay in R: MASS, lme4)
suppressMessages({library(MASS); library(lme4)})
options(contrasts = c("contr.sum", "contr.poly"), digits = 17)
teeth <- transform(ToothGrowth, dose = factor(dose))
carbon <- transform(as.data.frame(CO2), conc = factor(conc), Plant = factor(as.character(Plant)))
lost <- oats[-c(3, 17, 30, 31, 58), ]
sets <- list(npk = npk, warpbreaks = warpbreaks, ToothGrowth = teeth, InsectSprays = InsectSprays,
             oats = oats, oats_lost = lost, CO2 = carbon, Pastes = Pastes, Dyestuff = Dyestuff)
arguments <- commandArgs(TRUE)
if (length(arguments) == 2 && arguments[1] == "rows") {
  for (n in names(sets))
    write.csv(sets[[n]], file.path(arguments[2], paste0(n, ".csv")), row.names = FALSE)
  quit()
}
library(pbkrtest)
cat("# ", R.version.string, ", lme4 ", as.character(packageVersion("lme4")), ", pbkrtest ",
    as.character(packageVersion("pbkrtest")), ", made by r_datasets.R\n", sep = "")
cat("data,term,quantity,value\n")
put <- function(data, term, quantity, value)
  cat(sprintf("%s,%s,%s,%.17g\n", data, gsub(" ", "", term), quantity, value), sep = "")
table <- function(data, fit) {
  t <- anova(fit)
  for (i in seq_len(nrow(t) - 1)) {
    put(data, rownames(t)[i], "f", t[i, "F value"]); put(data, rownames(t)[i], "p", t[i, "Pr(>F)"])
  }
}
table("npk", lm(yield ~ block + N * P * K, npk))
table("warpbreaks", lm(breaks ~ wool * tension, warpbreaks))
table("ToothGrowth", lm(len ~ supp * dose, teeth))
table("InsectSprays", lm(count ~ spray, InsectSprays))
b <- bartlett.test(count ~ spray, InsectSprays); put("InsectSprays", "", "bartlett", b$statistic)
b <- fligner.test(count ~ spray, InsectSprays); put("InsectSprays", "", "fligner", b$statistic)
b <- oneway.test(count ~ spray, InsectSprays)
put("InsectSprays", "spray", "welch_f", b$statistic); put("InsectSprays", "spray", "welch_p", b$p.value)
s <- summary(aov(Y ~ N * V + Error(B / V), oats))
for (stratum in s) for (i in seq_len(nrow(stratum[[1]]))) {
  t <- stratum[[1]]; f <- t[i, "F value"]
  if (!is.null(f) && !is.na(f)) put("oats", trimws(rownames(t)[i]), "f", f)
}
tight <- lmerControl(optimizer = "bobyqa", optCtrl = list(rhoend = 1e-12, maxfun = 1e5))
components <- function(data, fit) {
  v <- as.data.frame(VarCorr(fit))
  for (i in seq_len(nrow(v))) put(data, v$grp[i], "sd", v$sdcor[i])
}
fit <- lmer(Y ~ N + V + (1 | B / V), lost, control = tight)
components("oats_lost", fit)
t <- KRmodcomp(fit, update(fit, . ~ . - N))$test
put("oats_lost", "N", "f", t["Ftest", "stat"]); put("oats_lost", "N", "df_error", t["Ftest", "ddf"])
fit <- lmer(uptake ~ Type * Treatment + conc + (1 | Plant), carbon, control = tight)
components("CO2", fit)
t <- KRmodcomp(fit, update(fit, . ~ . - conc))$test
put("CO2", "conc", "f", t["Ftest", "stat"]); put("CO2", "conc", "df_error", t["Ftest", "ddf"])
components("Pastes", lmer(strength ~ 1 + (1 | batch / cask), Pastes, control = tight))
components("Dyestuff", lmer(Yield ~ 1 + (1 | Batch), Dyestuff, control = tight))
